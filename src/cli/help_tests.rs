//! Checks that examples in help texts and documentation use existing keys.

use super::Cli;
use crate::config::RESERVED_VARIABLES;
use crate::config::layers::{ConfigError, Layers};
use crate::config::types::Config;
use clap::{Command, CommandFactory};
use std::path::Path;

/// Every user-facing text, with its name.
fn texts() -> Vec<(String, String)> {
    fn help(command: &mut Command, name: &str, out: &mut Vec<(String, String)>) {
        out.push((name.to_owned(), command.render_long_help().to_string()));
        for inner in command.get_subcommands_mut() {
            let name = format!("{name} {}", inner.get_name());
            help(inner, &name, out);
        }
    }
    let mut out = Vec::new();
    help(&mut Cli::command(), "volseggs", &mut out);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let docs = std::fs::read_dir(root.join("docs")).unwrap().map(|e| e.unwrap().path());
    for path in docs.chain([root.join("README.md"), root.join("CONTRIBUTING.md")]) {
        if path.extension().is_some_and(|e| e == "md") {
            out.push((path.display().to_string(), std::fs::read_to_string(&path).unwrap()));
        }
    }
    out
}

/// The text after each `start` in `text`, up to the first character that cannot belong to it.
fn after<'a>(text: &'a str, start: &'a str) -> impl Iterator<Item = &'a str> {
    text.match_indices(start).map(move |(at, _)| {
        let rest = &text[at + start.len()..];
        rest.split(|c: char| c.is_whitespace() || "`'\")|,;".contains(c)).next().unwrap_or_default()
    })
}

fn unknown(layers: Result<Layers<'_>, ConfigError>) -> Option<String> {
    match layers.and_then(|l| l.resolve::<Config>()) {
        Err(error @ (ConfigError::UnknownKey { .. } | ConfigError::Override(_) | ConfigError::Env { .. })) => {
            Some(error.to_string())
        }
        _ => None,
    }
}

#[test]
fn every_key_in_an_example_is_a_key() {
    let (mut keys, mut variables) = (0, 0);
    for (name, text) in texts() {
        for example in after(&text, "--set ").filter(|e| e.contains('=') && !e.contains("KEY=")) {
            keys += 1;
            // sweep keys that set how segments are evaluated
            if !example.starts_with("segments.") {
                assert_eq!(unknown(Ok(crate::method::layers().sets([example]))), None, "{name}: --set {example}");
            }
        }
        for example in after(&text, "VOLSEGGS_") {
            let key = example.split(['=', '.', ':', '*', '<', '\\']).next().unwrap_or_default();
            let variable = format!("VOLSEGGS_{key}");
            let known = |r: &&str| r.trim_end_matches('*') == variable || variable.starts_with(r.trim_end_matches('*'));
            if !key.is_empty() && !RESERVED_VARIABLES.iter().any(known) {
                variables += 1;
                let layers = crate::method::layers().env([(variable.clone().into(), "1".into())], RESERVED_VARIABLES);
                assert_eq!(unknown(layers), None, "{name}: {variable}");
            }
        }
    }
    assert!(keys >= 5, "{keys} keys, {variables} variables: the examples were not found");
}

#[test]
fn what_all_commands_have_is_under_no_heading() {
    fn check(command: &Command) {
        for argument in command.get_arguments().filter(|a| ["device", "json", "memory"].contains(&a.get_id().as_str()))
        {
            let (name, id) = (command.get_name(), argument.get_id());
            assert_eq!(argument.get_help_heading(), None, "{name} --{id}: is listed below the heading of others");
        }
        command.get_subcommands().for_each(check);
    }
    check(&Cli::command());
}

#[test]
fn completions_know_the_commands() {
    for shell in [clap_complete::Shell::Bash, clap_complete::Shell::Zsh, clap_complete::Shell::Fish] {
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut Cli::command(), "volseggs", &mut script);
        let script = String::from_utf8(script).unwrap();
        for word in ["segment", "completions", "resume"] {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
}
