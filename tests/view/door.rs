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

/// A reverse proxy that, as many do by default, replaces the header Host by the address of the viewer. Returns its port.
fn proxy(to: u16) -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let head = |stream: &mut TcpStream| {
        let (mut head, mut byte) = (Vec::new(), [0]);
        while !head.ends_with(b"\r\n\r\n") && stream.read(&mut byte).unwrap_or(0) == 1 {
            head.push(byte[0]);
        }
        String::from_utf8(head).unwrap_or_default()
    };
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            std::thread::spawn(move || {
                let mut client = stream.unwrap();
                let asked = head(&mut client);
                let mut viewer = TcpStream::connect(("127.0.0.1", to)).unwrap();
                // one request for each connection
                let keep = asked.contains("Upgrade: websocket");
                let lines = asked.trim_end().split("\r\n").filter(|l| {
                    let name = l.split(':').next().unwrap_or_default().to_ascii_lowercase();
                    name != "host" && (keep || name != "connection")
                });
                let lines: Vec<&str> = lines.collect();
                let more = if keep { "" } else { "Connection: close\r\n" };
                let sent = format!("{}\r\nHost: localhost:{to}\r\n{more}\r\n", lines.join("\r\n"));
                drop(viewer.write_all(sent.as_bytes()));
                let (mut from, mut back) = (client.try_clone().unwrap(), viewer.try_clone().unwrap());
                std::thread::spawn(move || std::io::copy(&mut from, &mut back));
                drop(std::io::copy(&mut viewer, &mut client));
                drop(client.shutdown(std::net::Shutdown::Both));
            });
        }
    });
    port
}

#[test]
fn what_a_proxy_does_wrong_is_said_in_the_terminal_once() {
    let folder = run();
    let (server, said) = Server::start_heard(folder.path(), &[]);
    let cookie = format!("Cookie: {}\r\n", server.cookie());
    let here = format!("Host: localhost:{}\r\n", server.port);
    // the page asks under which name it reached the viewer, as it is not told why a websocket is refused
    let (head, body) = get(&server, "/host", &format!("{here}{cookie}"));
    assert!(head.starts_with("http/1.1 200") && body == format!("localhost:{}", server.port), "{head} {body}");
    assert!(get(&server, "/host", &here).0.starts_with("http/1.1 403"));
    // who does not have the token is told, but the terminal is not
    let foreign = "Host: viz.example.org\r\n";
    let (head, body) = get(&server, "/", foreign);
    assert!(head.starts_with("http/1.1 403") && head.contains("connection: close"), "{head}");
    assert!(body.contains("--allow-host viz.example.org"), "{body}");
    let (_, body) = get(&server, "/", "Host: <script>\r\n");
    assert!(!body.contains("script"), "{body}");
    for _ in 0..3 {
        let host = ("Host", &*format!("localhost:{}", server.port));
        let opened = connect(&server, &[("Cookie", &server.cookie()), host, ("Origin", "https://viz.example.org")]);
        assert!(opened.is_err());
    }
    assert!(get(&server, "/", &format!("{foreign}{cookie}")).0.starts_with("http/1.1 403"));
    drop(server);
    let said = said.join().unwrap();
    let notes: Vec<&str> = said.lines().filter(|l| l.contains("viz.example.org")).collect();
    assert!(notes.len() == 1 && notes[0].contains("proxy_set_header Host $http_host"), "{said}");
    assert!(notes[0].contains("--allow-host viz.example.org"), "{said}");
}

#[test]
fn what_a_proxy_does_wrong_is_said_on_the_page() {
    let Some(mut browser) = crate::browser::Browser::start() else { return };
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let port = proxy(server.port);
    let tab = browser.open(&format!("http://127.0.0.1:{port}/?token={}", server.token));
    browser.wait(&tab, "document.getElementById('message').textContent.includes('proxy_set_header Host')");
    let said = browser.eval(&tab, "document.getElementById('message').textContent");
    let said = said.as_str().unwrap();
    assert!(said.contains(&format!("at 127.0.0.1:{port}")) && said.contains("--allow-host 127.0.0.1"), "{said}");
}

#[test]
fn clients_that_send_nothing_do_not_lock_the_owner_out() {
    let folder = run();
    let mut command = std::process::Command::new("sh");
    let program = "ulimit -n 100; exec \"$0\" view run";
    command.current_dir(folder.path()).args(["-c", program, crate::common::BINARY]);
    let server = Server::of(command);
    let silent: Vec<TcpStream> = (0..95)
        .map(|_| {
            let mut stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
            stream.write_all(b"GET / HTTP/1.1\r\nHost: loc").unwrap();
            stream
        })
        .collect();
    let began = std::time::Instant::now();
    let cookie = format!("Host: localhost:{}\r\nCookie: {}\r\n", server.port, server.cookie());
    // behind all of them in the queue: each is given ten seconds, fifty at a time
    let (head, _) = get(&server, "/", &cookie);
    assert!(head.starts_with("http/1.1 200"), "{head}");
    assert!(began.elapsed().as_secs() < 60, "{:?}", began.elapsed());
    // and they were ended
    let mut first = silent.into_iter().next().unwrap();
    first.set_read_timeout(Some(std::time::Duration::from_secs(20))).unwrap();
    assert_eq!(first.read(&mut [0; 8]).unwrap_or(1), 0);
}
