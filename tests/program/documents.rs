//! What the documentation shows must hold: the program parses every command in it, files that commands name can be read,
//! and every link and anchor leads somewhere.

use clap::error::ErrorKind;
use clap::{ArgMatches, CommandFactory};
use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use volseggs::cli::Cli;
use volseggs::config::layers::Layers;
use volseggs::config::types::Config;
use volseggs::sweep::slurm::SlurmProfile;
use volseggs::sweep::{Plan, PlanOptions};
use volseggs::volume::transfer::TransferFunction;

/// Folders of the repository: a word of a command that begins with one of them names a file that must exist.
const FOLDERS: [&str; 9] =
    ["configs/", "docs/", "scripts/", "benches/", "examples/", "tests/", "kernels/", "testing/", ".ci/"];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All files of the repository with one of these extensions, relative to its root; neither build outputs nor runs.
fn files(extensions: &[&str]) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![PathBuf::new()]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let (path, name) = (folder.join(entry.file_name()), entry.file_name().to_string_lossy().into_owned());
            let kind = entry.file_type().unwrap();
            let outputs = ["target", "checkpoints", "data"].contains(&name.as_str()) && folder == Path::new("");
            if kind.is_dir() && !name.starts_with('.') && !outputs {
                folders.push(path);
            } else if kind.is_file() && path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
                found.push(path);
            }
        }
    }
    found.push("checkpoints/README.md".into());
    found.retain(|path| path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)));
    found.sort();
    found
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(root().join(path)).unwrap()
}

/// Pages of measurements, and the list of changes, show commands of their day.
fn is_dated(page: &Path) -> bool {
    page.starts_with("benches/results") || page == Path::new("CHANGELOG.md")
}

/// The lines of a page in blocks of code (`true`) and outside of them, without the fences; for code, its language.
fn lines(page: &str) -> Vec<(Option<String>, &str)> {
    let (mut out, mut language) = (Vec::new(), None::<String>);
    for line in page.lines() {
        match line.trim_start().strip_prefix("```") {
            Some(name) => language = if language.is_some() { None } else { Some(name.trim().to_owned()) },
            None => out.push((language.clone(), line)),
        }
    }
    out
}

/// What stands in back quotes in `text`.
fn spans(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// The simple commands of a line of a shell, as words, without comments and what follows a redirection.
fn shell(line: &str) -> Vec<Vec<String>> {
    let (mut all, mut words) = (Vec::new(), Vec::new());
    let (mut word, mut quote) = (None::<String>, None);
    for c in line.chars().chain([' ']) {
        match (quote, c) {
            (Some(q), c) if c == q => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '\'' | '"') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#' | '>') if word.is_none() => break,
            (None, '&' | ';' | '|') => {
                words.extend(word.take());
                all.push(std::mem::take(&mut words));
            }
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    all.push(words);
    all.retain(|words| !words.is_empty());
    all
}

/// The command line of this program in a simple command, if it calls it.
fn of_this_program(words: &[String]) -> Option<Vec<String>> {
    let is_setting = |w: &&String| {
        w.split_once('=').is_some_and(|(name, _)| name.bytes().all(|b| b == b'_' || b.is_ascii_uppercase()))
    };
    let start = words.iter().take_while(is_setting).count();
    let (program, rest) = words[start..].split_first()?;
    let arguments = if Path::new(program).file_name()? == "volseggs" {
        rest
    } else if program == "cargo" && rest.first()? == "run" {
        let end = rest.iter().position(|w| w == "--")?;
        &rest[end + 1..]
    } else {
        return None;
    };
    Some(std::iter::once("volseggs".to_owned()).chain(arguments.iter().cloned()).collect())
}

/// Whether a word begins with a folder of the repository, and is not a form such as `NAME-small.toml`.
fn is_ours(word: &str) -> bool {
    let is_form = ["NAME", "SIZE", "*"].iter().any(|form| word.contains(form));
    FOLDERS.iter().any(|folder| word.starts_with(folder)) && !is_form
}

/// A file that a reader has to bring: not one of this repository, nor a preset.
fn is_placeholder(name: &str) -> bool {
    !is_ours(name) && (name.contains('.') || name.chars().any(char::is_uppercase))
}

/// The values of the option or argument `id`, as typed.
fn values(matches: &ArgMatches, id: &str) -> Vec<String> {
    let raw = matches.try_get_raw(id).ok().flatten();
    raw.map(|raw| raw.map(|v| v.to_string_lossy().into_owned()).collect()).unwrap_or_default()
}

/// Opens what a command would read of this repository: configurations, transfer functions, sweeps, Slurm's settings.
fn open_files(matches: &ArgMatches, out: &Path) -> Result<(), String> {
    let (mut inner, mut names) = (matches, Vec::new());
    while let Some((name, next)) = inner.subcommand() {
        names.push(name);
        inner = next;
    }
    let set = values(inner, "set");
    let is_of_training = |s: &&String| !s.starts_with("segments.") && !s.contains("KEY=VALUE");
    if names != ["sweep"] && !set.iter().any(|s| s.contains("extra") || s.starts_with("method")) {
        let configs = values(inner, "config");
        let layers = configs.iter().filter(|c| !is_placeholder(c)).fold(volseggs::method::layers(), Layers::source);
        layers.sets(set.iter().filter(is_of_training)).resolve::<Config>().map_err(|e| e.to_string())?;
    }
    for name in values(inner, "transfer_function").iter().filter(|name| !is_placeholder(name)) {
        TransferFunction::load(name).map_err(|e| e.to_string())?;
    }
    for file in values(inner, "profile").iter().filter(|file| !is_placeholder(file)) {
        SlurmProfile::read(Path::new(file)).map_err(|e| e.to_string())?;
    }
    if let (["sweep"], [file]) = (&names[..], &values(inner, "file")[..])
        && !is_placeholder(file)
    {
        let options = PlanOptions { out: out.into(), set, elsewhere: true, ..PlanOptions::default() };
        Plan::new(Path::new(file), &options).map_err(|e| e.to_string())?;
    }
    Ok(())
}

/// What is wrong with a command, if anything. Names of commands in running text need no arguments.
fn fault(words: &[String], in_text: bool, out: &Path) -> Option<String> {
    let missing = words.iter().find(|word| is_ours(word) && !Path::new(word).exists());
    if let Some(file) = missing {
        return Some(format!("{file} does not exist"));
    }
    let command = of_this_program(words)?;
    match Cli::matches(&command) {
        Err(e) if matches!(e.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion) => None,
        Err(e) if in_text && e.kind() == ErrorKind::MissingRequiredArgument => None,
        Err(e) if in_text && e.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => None,
        Err(e) => Some(e.to_string()),
        Ok(arguments) => open_files(&arguments, out).err(),
    }
}

/// The commands of blocks of code, one a line, with continued lines joined.
fn in_blocks(page: &str) -> Vec<String> {
    let mut commands: Vec<String> = Vec::new();
    let mut continued = false;
    for (language, line) in lines(page) {
        if !language.is_some_and(|l| ["", "sh", "bash", "console"].contains(&l.as_str())) {
            continue;
        }
        let (text, more) = line.strip_suffix('\\').map_or((line, false), |text| (text, true));
        match commands.last_mut().filter(|_| continued) {
            Some(command) => command.push_str(text),
            None => commands.push(text.to_owned()),
        }
        continued = more;
    }
    commands
}

/// The examples in the help of `command` and of those below it.
fn in_help(command: &mut clap::Command, out: &mut Vec<String>) {
    let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    out.extend(help.lines().filter(|line| line.trim_start().starts_with("volseggs ")).map(str::to_owned));
    command.get_subcommands_mut().for_each(|inner| in_help(inner, out));
}

#[test]
fn every_command_in_the_documentation_is_accepted_and_its_files_can_be_read() {
    let out = tempfile::tempdir().unwrap();
    let (mut faults, mut parsed) = (Vec::new(), HashMap::from([("block", 0), ("text", 0), ("help", 0)]));
    let mut check = |page: &str, line: &str, kind: &'static str| {
        for words in shell(line) {
            *parsed.get_mut(kind).unwrap() += usize::from(of_this_program(&words).is_some());
            faults.extend(fault(&words, kind == "text", out.path()).map(|e| format!("{page}: {line}\n  {e}")));
        }
    };
    for path in files(&["md", "toml"]).iter().filter(|path| !is_dated(path)) {
        let (name, text) = (path.display().to_string(), read(path));
        let is_page = path.extension().is_some_and(|e| e == "md");
        if is_page {
            in_blocks(&text).iter().for_each(|command| check(&name, command, "block"));
        }
        let prose: Vec<&str> = if is_page {
            lines(&text).into_iter().filter(|(language, _)| language.is_none()).map(|(_, line)| line).collect()
        } else {
            text.lines().filter_map(|line| line.strip_prefix('#')).collect()
        };
        // a span may be broken over two lines of a paragraph
        for paragraph in prose.split(|line| line.trim().is_empty()) {
            for span in spans(&paragraph.join(" ")).filter(|span| span.starts_with("volseggs ")) {
                // forms rather than commands
                if !["...", "COMMAND", "|"].iter().any(|form| span.contains(form)) {
                    check(&name, span, "text");
                }
            }
        }
    }
    let mut examples = Vec::new();
    in_help(&mut Cli::command(), &mut examples);
    examples.iter().for_each(|line| check("--help", line, "help"));
    assert!(faults.is_empty(), "{} of the documentation's commands do not work:\n{}", faults.len(), faults.join("\n"));
    assert!(parsed["block"] >= 50 && parsed["text"] >= 20 && parsed["help"] >= 60, "too few were found: {parsed:?}");
}

/// The anchor that a heading gets, as on GitHub.
fn anchor(heading: &str) -> String {
    // of a link, only its text is shown
    let mut shown = String::new();
    let mut rest = heading;
    while let Some((before, after)) = rest.split_once("](") {
        shown.push_str(before);
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    shown.push_str(rest);
    let kept = shown.trim().chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
    kept.map(|c| if c == ' ' { '-' } else { c }).flat_map(char::to_lowercase).collect()
}

fn anchors(page: &str) -> BTreeSet<String> {
    let mut met: HashMap<String, usize> = HashMap::new();
    let mut out = BTreeSet::new();
    for (_, line) in lines(page).into_iter().filter(|(language, _)| language.is_none()) {
        let heading = line.trim_start_matches('#');
        if heading.len() < line.len() && heading.starts_with(' ') {
            let name = anchor(heading);
            let n = met.entry(name.clone()).or_default();
            out.insert(if *n == 0 { name } else { format!("{name}-{n}") });
            *n += 1;
        }
    }
    out
}

/// The targets of the links and pictures of a page, without its code.
fn targets(page: &str) -> Vec<String> {
    let prose: Vec<&str> = lines(page).into_iter().filter(|(language, _)| language.is_none()).map(|(_, l)| l).collect();
    // the text of a link may be code, or broken over lines
    let prose = prose.join("\n");
    let after = prose.match_indices("](").map(|(at, _)| &prose[at + 2..]);
    after.filter_map(|rest| rest.split([')', ' ', '\n']).next()).map(str::to_owned).collect()
}

#[test]
fn every_link_between_pages_leads_somewhere() {
    let pages = files(&["md"]);
    let mut known: HashMap<PathBuf, BTreeSet<String>> = HashMap::new();
    let (mut broken, mut links) = (Vec::new(), 0);
    for page in &pages {
        for target in targets(&read(page)) {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            links += 1;
            let (file, fragment) = target.split_once('#').unwrap_or((&target, ""));
            let folder = page.parent().unwrap_or(Path::new(""));
            let path = root().join(if file.is_empty() { page.clone() } else { folder.join(file) });
            if !path.exists() {
                broken.push(format!("{}: {target}: no such file", page.display()));
            } else if !fragment.is_empty() && path.extension().is_some_and(|e| e == "md") {
                let path = std::fs::canonicalize(&path).unwrap();
                let there =
                    known.entry(path.clone()).or_insert_with(|| anchors(&std::fs::read_to_string(&path).unwrap()));
                if !there.contains(fragment) {
                    broken.push(format!("{}: {target}: no such heading", page.display()));
                }
            }
        }
    }
    assert!(broken.is_empty(), "{} of {links} links:\n{}", broken.len(), broken.join("\n"));
    assert!(pages.len() > 50 && links > 300, "{links} links in {} pages: they were not found", pages.len());
}

#[test]
fn pages_that_code_and_settings_name_exist() {
    let mut missing = Vec::new();
    for path in files(&["rs", "toml", "py"]) {
        let text = read(&path);
        for (at, _) in text.match_indices("docs/") {
            let name: String = text[at..].chars().take_while(|c| c.is_alphanumeric() || "/-_.".contains(*c)).collect();
            if let Some((name, _)) = name.split_once(".md")
                && !root().join(format!("{name}.md")).exists()
            {
                missing.push(format!("{}: {name}.md", path.display()));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
}

#[test]
fn the_readme_is_one_page() {
    let words = read(Path::new("README.md")).split_whitespace().count();
    assert!(words <= 900, "{words} words; what does not fit belongs into docs/");
}
