//! `monogrid completions` and `monogrid man`: what shells and readers of manuals know about the
//! command line.

use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::{Classify, CommandResult, Outcome};
use std::path::PathBuf;

/// `monogrid completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// For which shell
    pub shell: Shell,
}

/// `monogrid man`.
#[derive(Debug, Args)]
pub struct ManArgs {
    /// Output folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace the output file if it exists; never one that is read
    #[arg(long)]
    pub force: bool,
}

/// Prints the script for the command line of `program`.
pub fn completions(args: &CompletionsArgs, mut program: Command) -> CommandResult {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, "monogrid", &mut script);
    print!("{}", String::from_utf8_lossy(&script));
    Ok(Outcome::Done)
}

/// Writes a page for the program and one for each command: `monogrid.1`, `monogrid-run.1`, ...
pub fn man(args: &ManArgs, program: Command) -> CommandResult {
    let folder = OutputFolder::replace(&args.out, args.force, &Inputs::default())?;
    let mut program = program.disable_help_subcommand(true);
    program.build();
    let mut waiting = vec![program];
    let mut count = 0;
    while let Some(command) = waiting.pop() {
        let name = command.get_display_name().unwrap_or("monogrid").to_owned();
        waiting.extend(command.get_subcommands().cloned());
        let mut page = Vec::new();
        let rendered = Man::new(command).render(&mut page);
        rendered.while_running("a page of the manual cannot be made")?;
        folder.write(&format!("{name}.1"), page)?;
        count += 1;
    }
    println!("{count} pages in {}", folder.path().display());
    Ok(Outcome::Done)
}
