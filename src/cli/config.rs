//! `volseggs config`, and the options by which commands accept a configuration.

use super::CliError;
use crate::config::layers::{Layers, Resolved, file_schema};
use crate::config::types::{Config, segment::SECTION as SEGMENT};
use crate::config::{PRESET_IF_NONE_GIVEN, RESERVED_VARIABLES};
use crate::method;
use clap::{Args, Subcommand};
use std::path::Path;

/// Where a configuration comes from.
#[derive(Debug, Clone, Args)]
pub struct ConfigSource {
    #[arg(long, value_name = "NAME", help = method_help())]
    method: Option<String>,
    /// Configuration file (TOML) or preset: best (if none is given), quick, demo, paper, official, static; for the other
    /// methods, the method's name or NAME-small (for two cores).
    #[arg(long, value_name = "FILE")]
    config: Option<String>,
    /// Override a key, such as loss.dssim=0.2; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
}

/// Help on `--method`, with the methods that there are.
fn method_help() -> String {
    let names = method::names();
    format!(
        "Method: {} (the first one is this project's own, and the default). The preset of that name is applied first, then \
         --config",
        names.join(", ")
    )
}

impl ConfigSource {
    /// Returns the preset that is used because neither a file nor the preset of another method is given.
    pub(super) fn preset_if_none_given(&self) -> Option<&'static str> {
        (self.config.is_none() && self.preset_of_method().is_none()).then_some(PRESET_IF_NONE_GIVEN)
    }

    /// Returns the preset of the method, if it has one.
    fn preset_of_method(&self) -> Option<&str> {
        self.method.as_deref().filter(|name| method::presets().iter().any(|(preset, _)| preset == name))
    }

    /// Resolves the defaults, the method's preset, the file and what it extends, `VOLSEGGS_*` variables and `--set`.
    pub(super) fn resolve(&self) -> Result<Resolved<Config>, CliError> {
        if let Some(name) = &self.method {
            method::find(name).map_err(|e| CliError::input(format!("--method: {e}")))?;
        }
        let sources = [self.preset_of_method(), self.config.as_deref(), self.preset_if_none_given()];
        let mut layers = sources.into_iter().flatten().fold(method::layers(), Layers::source);
        if let (Some(name), None) = (&self.method, self.preset_of_method()) {
            layers = layers.sets([format!("method={name}")]);
        }
        let layers = layers.env(std::env::vars_os(), RESERVED_VARIABLES)?;
        let resolved = layers.sets(self.set.iter().cloned()).resolve::<Config>()?;
        match &self.method {
            Some(name) if *name != resolved.value.method => Err(CliError::input(format!(
                "--method {name}: the rest of the configuration is for the method {}; omit one of the two",
                resolved.value.method
            ))),
            _ => Ok(resolved),
        }
    }

    /// Resolves the configuration of a resumed run: `--config` if given, or else the run's own file, then variables and
    /// `--set`.
    pub(super) fn resolve_over(&self, run_config: &Path) -> Result<Resolved<Config>, CliError> {
        if self.config.is_some() {
            return self.resolve();
        }
        if !run_config.is_file() {
            return Err(CliError::input(format!(
                "{}: not found; give the folder that `volseggs train --out` made",
                run_config.display()
            )));
        }
        let config = run_config.to_string_lossy().into_owned();
        method::layers().source(&config).resolve::<Config>()?.complete(run_config, SEGMENT)?;
        Self { config: Some(config), ..self.clone() }.resolve()
    }
}

/// Show the resolved configuration, the presets or the JSON Schema.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  volseggs config show --config quick --set loss.tv=0\n  volseggs config schema > configs/schema.json\n  volseggs config presets"
)]
pub struct ConfigArgs {
    #[command(subcommand)]
    action: ConfigAction,
}

#[derive(Debug, Subcommand)]
enum ConfigAction {
    /// Show every key with its value and where the value came from, if a training could start with them.
    Show {
        #[command(flatten)]
        source: ConfigSource,
        /// Print the values as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Print the JSON Schema of configuration files.
    Schema,
    /// List the built-in presets.
    Presets,
}

impl ConfigArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        match self.action {
            ConfigAction::Show { source, json } => {
                let resolved = source.resolve()?;
                method::check(&resolved.value)?;
                if json { super::print_json(&resolved.value)? } else { out!("{}", resolved.show()) }
            }
            ConfigAction::Schema => {
                method::add_sections();
                super::print_json(&file_schema(&Config::default()))?;
            }
            ConfigAction::Presets => method::presets().into_iter().for_each(|(name, text)| {
                let comment: Vec<&str> = text.lines().map_while(|l| l.strip_prefix("# ")).collect();
                outln!("{name}: {}", comment.join(" "));
            }),
        }
        Ok(())
    }
}
