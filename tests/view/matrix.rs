//! Access to the viewer, for every combination of host, origin, secret, method and path.

use crate::browser::Browser;
use crate::run;
use crate::socket::Server;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Returns the head of the answer in lower case; a websocket's connection stays open after it.
fn head(server: &Server, request: &str) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    let mut part = [0; 4096];
    while !answer.windows(4).any(|w| w == b"\r\n\r\n") {
        match stream.read(&mut part) {
            Ok(0) => break,
            Ok(n) => answer.extend_from_slice(&part[..n]),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) => panic!("{request}: {e}"),
        }
    }
    String::from_utf8_lossy(&answer).to_ascii_lowercase()
}

#[test]
fn every_combination_of_host_origin_secret_and_method() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let port = server.port;
    let hosts = [
        (Some(format!("localhost:{port}")), true),
        (Some(format!("127.0.0.1:{port}")), true),
        // an ssh tunnel may have another port
        (Some("localhost:9".to_owned()), true),
        (Some(format!("evil.example:{port}")), false),
        (Some(format!("localhost.evil.example:{port}")), false),
        (Some(format!("127.0.0.1.evil.example:{port}")), false),
        (None, false),
    ];
    // an origin that names its host belongs to this server's own page if that host does
    let origins = [Some("=host"), Some("http://evil.example"), Some("null"), Some("http://localhost:1"), None];
    let wrong = "0".repeat(32);
    let cookie = |value: &str| format!("Cookie: a=b; {}={value}\r\n", server.cookie_name());
    // cookie, and token in the address
    let secrets = [
        (cookie(&server.token), String::new(), true, false),
        (cookie(&wrong), String::new(), false, false),
        (String::new(), String::new(), false, false),
        (String::new(), format!("?token={}", server.token), false, true),
        (String::new(), format!("?token={wrong}"), false, false),
        (cookie(&wrong), format!("?token={}", server.token), false, true),
        // a client that has both gets an address without the secret
        (cookie(&server.token), format!("?token={}", server.token), true, true),
        (cookie(&server.token), format!("?token={wrong}"), true, false),
        (format!("Cookie: volseggs-00000000={}\r\n", server.token), String::new(), false, false),
    ];
    let upgrade = "Upgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let (mut asked, mut opened) = (0, 0);
    for (host, host_right) in &hosts {
        for origin in origins {
            for (cookie, query, known, brings) in &secrets {
                for method in ["GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS"] {
                    for path in ["/", "/ws", "/run.json"] {
                        let host_line = host.as_ref().map_or(String::new(), |h| format!("Host: {h}\r\n"));
                        let own = host.as_ref().map(|h| format!("http://{h}"));
                        let of = if origin == Some("=host") { own.clone() } else { origin.map(str::to_owned) };
                        let origin_line = of.as_ref().map_or(String::new(), |o| format!("Origin: {o}\r\n"));
                        let connection = if path == "/ws" { "Upgrade" } else { "close" };
                        let request = format!(
                            "{method} {path}{query} HTTP/1.1\r\n{host_line}{origin_line}{cookie}Connection: {connection}\r\n{}\r\n",
                            if path == "/ws" { upgrade } else { "" }
                        );
                        let expected: &[u32] = match (host_right, known, brings) {
                            (false, ..) => &[400, 403],
                            (true, true, false) => match (path, method) {
                                ("/", "GET" | "HEAD") => &[200],
                                ("/ws", "GET") if of.is_some() && of == own => &[101],
                                ("/ws", "GET") => &[403],
                                ("/run.json", _) => &[404],
                                _ => &[400, 405],
                            },
                            (true, _, true) => &[303],
                            (true, false, false) => &[403],
                        };
                        let answer = head(&server, &request);
                        let status = answer
                            .get(9..12)
                            .and_then(|s| s.parse().ok())
                            .unwrap_or_else(|| panic!("{request}{answer}"));
                        assert!(expected.contains(&status), "{request}{answer}");
                        assert!(
                            status == 400 || answer.contains("content-security-policy: default-src 'none'"),
                            "{answer}"
                        );
                        let reveals = answer.contains(&server.token);
                        assert_eq!(
                            reveals,
                            status == 303,
                            "only clients that send the secret get it: {request}{answer}"
                        );
                        asked += 1;
                        if status == 101 {
                            opened += 1;
                            // at most eight windows at a time, and this one will be gone in a moment
                            std::thread::sleep(Duration::from_millis(50));
                        }
                    }
                }
            }
        }
    }
    assert_eq!((asked, opened), (7 * 5 * 9 * 6 * 3, 6));
}

#[test]
fn the_page_loads_nothing_but_its_own_files() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let tab = browser.visit(&server);
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
    for forbidden in [
        "document.body.append(Object.assign(document.createElement('script'), { textContent: 'window.bad = 1' }))",
        "document.body.append(Object.assign(document.createElement('img'), { src: 'http://localhost:1/x.png' }))",
        "fetch('http://localhost:1/x').catch(() => 0)",
    ] {
        let before = browser.wrong.len();
        browser.eval(&tab, &format!("(() => {{ {forbidden}; return 0; }})()"));
        browser.wait(&tab, "true");
        std::thread::sleep(Duration::from_millis(300));
        browser.eval(&tab, "0");
        let errors = browser.wrong[before..].concat();
        assert!(errors.contains("Content Security Policy"), "{forbidden}: {errors}");
    }
    assert_eq!(browser.eval(&tab, "String(window.bad)"), "undefined");
}
