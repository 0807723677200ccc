//! Access to the viewer: every combination of host, origin and token; messages that are too long or malformed.

use crate::socket::{Server, Window, connect, cookie_name};
use crate::{run, view};
use std::io::{Read, Write};
use std::net::TcpStream;

/// Sends a request with these headers; returns the status line and headers of the answer, in lower case, and the rest.
fn get(server: &Server, path: &str, headers: &str) -> (String, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\n{headers}Connection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    (head.to_ascii_lowercase(), body.to_owned())
}

#[test]
fn only_requests_to_this_server_with_its_token_are_accepted() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (cookie, port) = (format!("Cookie: {}\r\n", server.cookie()), server.port);
    let here = format!("Host: localhost:{port}\r\n");
    let elsewhere = "Host: evil.example\r\n".to_owned();
    let wrong = format!("Cookie: {}={}\r\n", server.cookie_name(), "0".repeat(32));
    for path in ["/", "/app.js", "/style.css", "/camera.js"] {
        for (headers, status) in [
            (format!("{here}{cookie}"), "200"),
            (here.clone(), "403"),
            (format!("{here}{wrong}"), "403"),
            (format!("{elsewhere}{cookie}"), "403"),
            (elsewhere.clone(), "403"),
        ] {
            let (head, body) = get(&server, path, &headers);
            assert!(head.starts_with(&format!("http/1.1 {status}")), "{path} {headers}: {head}");
            assert!(head.contains("content-security-policy: default-src 'none'"), "{head}");
            assert!(
                head.contains("x-content-type-options: nosniff") && head.contains("cache-control: no-store"),
                "{head}"
            );
            assert!(!body.contains(&server.token));
        }
    }
    // the token in the address becomes a cookie, and is removed from the address
    let (head, _) = get(&server, &format!("/?token={}", server.token), &here);
    assert!(head.starts_with("http/1.1 303") && head.contains("location: /\r\n"), "{head}");
    assert!(head.contains("set-cookie: ") && head.contains("httponly") && head.contains("samesite=strict"), "{head}");
    for path in ["/?token=0", "/?token=", "/?other=1"] {
        assert!(get(&server, path, &here).0.starts_with("http/1.1 403"), "{path}");
    }
    assert!(get(&server, &format!("/?token={}", server.token), &elsewhere).0.starts_with("http/1.1 403"));
    // only the page is served, whatever the path
    for path in ["/../Cargo.toml", "/%2e%2e/run/run.json", "/run/run.json", "//etc/passwd", "/ws/x"] {
        let (head, _) = get(&server, path, &format!("{here}{cookie}"));
        assert!(head.starts_with("http/1.1 404") || head.starts_with("http/1.1 400"), "{path}: {head}");
    }

    let cookie = server.cookie();
    let own = format!("http://localhost:{port}");
    let other_port = format!("http://localhost:{}", port ^ 1);
    for (origin, allowed) in
        [(&own[..], true), ("http://evil.example", false), (&other_port, false), ("null", false), ("", false)]
    {
        for (given, known) in [(&cookie[..], true), ("", false), (&format!("{}=00", server.cookie_name()), false)] {
            let opened = connect(&server, &[("Cookie", given), ("Origin", origin)]);
            assert_eq!(opened.is_ok(), allowed && known, "{origin} {given}");
        }
    }
    assert!(
        connect(&server, &[("Cookie", &cookie), ("Host", "evil.example"), ("Origin", "http://evil.example")]).is_err()
    );
}

#[test]
fn invalid_messages_are_answered_and_oversized_ones_end_the_connection() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    for text in ["", "{", "null", "[]", "{\"type\":\"view\"}", "{\"type\":\"exec\",\"path\":\"/etc/passwd\"}", "\u{0}"]
    {
        window.say_text(text);
        window.wait_for(|m| m["type"] == "error");
    }
    let mut bad = view(&welcome, 0.5, "colour", false);
    for (key, value) in
        [("eye", "[1e400,0,0]"), ("size", "[0,0]"), ("size", "[99999,99999]"), ("time", "2"), ("look", "\"x\"")]
    {
        let old = bad[key].clone();
        let text = bad.to_string().replace(&format!("\"{key}\":{old}"), &format!("\"{key}\":{value}"));
        window.say_text(&text);
        window.wait_for(|m| m["type"] == "error");
        bad[key] = old;
    }
    // it still draws
    window.say(&view(&welcome, 0.5, "colour", false));
    window.lossless();
    let (mut loud, _) = Window::open(&server);
    loud.say_text(&format!("{{\"type\":\"clear\",\"x\":\"{}\"}}", "x".repeat(70_000)));
    assert!(loud.is_closed());
    window.say(&view(&welcome, 0.6, "colour", false));
    window.lossless();
    // nine windows are one too many
    let more: Vec<_> = (0..7).map(|_| connect(&server, &[("Cookie", &server.cookie())])).collect();
    assert!(more.iter().filter(|w| w.is_ok()).count() >= 6);
    let mut last = connect(&server, &[("Cookie", &server.cookie())]).unwrap();
    let said = last.read().unwrap().into_text().unwrap();
    assert!(said.contains("\"ended\"") && said.contains("too many windows are open"), "{said}");
    assert!(last.read().unwrap().is_close());
}

#[cfg(unix)]
#[test]
fn a_socket_file_is_private_to_its_owner_and_removed_at_the_end() {
    use std::io::{BufRead, BufReader};
    use std::os::unix::fs::PermissionsExt;
    use std::os::unix::net::UnixStream;
    use std::process::{Command, Stdio};
    let folder = run();
    let socket = folder.path().join("viewer.sock");
    let start = || {
        let mut command = Command::new(crate::common::BINARY);
        command.current_dir(folder.path()).args(["view", "run", "--socket", "viewer.sock", "--port", "9000"]);
        command.env("SSH_CONNECTION", "10.0.0.2 51234 10.0.0.9 22").env("USER", "ada");
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let mut viewer = start();
    let mut url = String::new();
    BufReader::new(viewer.stdout.take().unwrap()).read_line(&mut url).unwrap();
    let token = url.trim().strip_prefix("http://localhost:9000/?token=").unwrap();
    let mut line = String::new();
    BufReader::new(viewer.stderr.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains(&format!("ssh -L 9000:{} ada@10.0.0.9", socket.canonicalize().unwrap().display())), "{line}");
    assert_eq!(std::fs::metadata(&socket).unwrap().permissions().mode() & 0o777, 0o600);
    let ask = |cookie: &str| {
        let mut stream = UnixStream::connect(&socket).unwrap();
        write!(stream, "GET / HTTP/1.1\r\nHost: localhost:9000\r\n{cookie}Connection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    assert!(ask("").starts_with("HTTP/1.1 403"));
    assert!(ask(&format!("Cookie: {}={token}\r\n", cookie_name(token))).starts_with("HTTP/1.1 200"));
    let second = start().wait_with_output().unwrap();
    let said = String::from_utf8(second.stderr).unwrap();
    assert!(second.status.code() == Some(2) && said.contains("another viewer listens there"), "{said}");
    assert!(Command::new("kill").arg(viewer.id().to_string()).status().unwrap().success());
    viewer.wait().unwrap();
    assert!(!socket.exists());
}
