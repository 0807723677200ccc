//! `volseggs completions`

use super::{Cli, CliError};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, CommandFactory};
use clap_complete::Shell;

/// Print the completion script for a shell.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs completions bash > ~/.local/share/bash-completion/completions/volseggs\n  volseggs completions zsh > ~/.zfunc/_volseggs        # with fpath+=~/.zfunc before compinit in ~/.zshrc\n  volseggs completions fish > ~/.config/fish/completions/volseggs.fish"
)]
pub struct CompletionsArgs {
    /// The shell.
    #[arg(value_parser = PossibleValuesParser::new(["bash", "zsh", "fish"]).try_map(|name| name.parse::<Shell>()))]
    shell: Shell,
}

impl CompletionsArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        // written to memory first, as the library panics if standard output is closed
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "volseggs", &mut script);
        out!("{}", String::from_utf8_lossy(&script));
        Ok(())
    }
}
