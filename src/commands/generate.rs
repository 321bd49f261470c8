//! `trifacet generate`: writes man pages and shell completions, for packages.

use std::fs;
use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use clap_complete::{Shell, generate_to};

/// Options of `generate`.
#[derive(Debug, Args)]
pub(crate) struct GenerateArgs {
    /// Folder in which man/ and completions/ are created
    folder: PathBuf,
}

/// Writes a man page for `program` and each of its commands, and completions for three shells.
pub(crate) fn generate(args: &GenerateArgs, program: clap::Command) -> anyhow::Result<()> {
    let (man, completions) = (args.folder.join("man"), args.folder.join("completions"));
    for folder in [&man, &completions] {
        fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    let mut program = without_help(program);
    clap_mangen::generate_to(program.clone(), &man)
        .with_context(|| format!("cannot write into {}", man.display()))?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        generate_to(shell, &mut program, "trifacet", &completions)
            .with_context(|| format!("cannot write into {}", completions.display()))?;
    }
    Ok(())
}

/// Removes the `help` commands: they repeat all others and need no pages.
fn without_help(command: clap::Command) -> clap::Command {
    command.disable_help_subcommand(true).mut_subcommands(without_help)
}
