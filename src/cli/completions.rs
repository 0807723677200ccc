//! `volseggs completions`

use super::{Cli, CliError};
use clap::{Args, CommandFactory, ValueEnum};
use clap_complete::Shell;

/// Print the completion script for a shell.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs completions bash > ~/.local/share/bash-completion/completions/volseggs\n  volseggs completions zsh > ~/.zfunc/_volseggs        # with fpath+=~/.zfunc before compinit in ~/.zshrc\n  volseggs completions fish > ~/.config/fish/completions/volseggs.fish"
)]
pub struct CompletionsArgs {
    /// The shell.
    shell: ShellName,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum ShellName {
    Bash,
    Zsh,
    Fish,
}

impl CompletionsArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let shell = match self.shell {
            ShellName::Bash => Shell::Bash,
            ShellName::Zsh => Shell::Zsh,
            ShellName::Fish => Shell::Fish,
        };
        // written to memory first, as the library panics if standard output is closed
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut Cli::command(), "volseggs", &mut script);
        out!("{}", String::from_utf8_lossy(&script));
        Ok(())
    }
}
