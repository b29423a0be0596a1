//! Commands outside this program: `wingd X` runs `wingd-X` from the PATH, as git and cargo do.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Command;

/// Commands of the Python package.
pub const PACKAGE_COMMANDS: [&str; 9] = [
    "convert",
    "deform",
    "difference",
    "fleet",
    "loads",
    "mean",
    "table",
    "time-check",
    "upload",
];

/// Beginning of the names of external programs.
const PREFIX: &str = "wingd-";

/// Becomes `wingd-X` if the arguments are `X …` or `help X`, and this program has no command `X`. Returns only if it cannot: the
/// exit status, or `None` if there is no such program.
pub(super) fn run_external(command: &Command, arguments: &[OsString]) -> Option<ExitCode> {
    let texts = arguments.iter().skip(1).map(|text| text.to_str());
    let (name, given) = match texts.take(2).collect::<Vec<_>>().as_slice() {
        [Some("help"), Some(name)] => (*name, vec![OsString::from("--help")]),
        [Some(name), ..] => (*name, arguments.get(2..).unwrap_or_default().to_vec()),
        _ => return None,
    };
    if !is_name(name) || is_built_in(command, name) {
        return None;
    }
    let Some(path) = find_program(name) else {
        return PACKAGE_COMMANDS.contains(&name).then(|| {
            eprintln!(
                "wingd: `wingd {name}` is in the Python package, which is not on the PATH: `pip install ./python`, or install \
                the package wingd-desk"
            );
            ExitCode::from(2)
        });
    };
    let mut process = std::process::Command::new(&path);
    process.args(given);
    // What it computes, it computes with this program.
    if let (None, Ok(own)) = (std::env::var_os("WINGD"), std::env::current_exe()) {
        process.env("WINGD", own);
    }
    let error = process.exec();
    eprintln!(
        "wingd: {}: cannot be run ({error}); install it again",
        path.display()
    );
    Some(ExitCode::from(1))
}

/// Adds the external commands on the PATH to the help, if the arguments ask for it.
pub(super) fn list_external(command: Command, arguments: &[OsString]) -> Command {
    let asked = |text: &OsString| ["help", "-h", "--help"].iter().any(|word| text == word);
    let found = match arguments.get(1) {
        Some(first) if !asked(first) => return command,
        _ => external_names(&command),
    };
    if found.is_empty() {
        return command;
    }
    let about = command.get_after_help().map(ToString::to_string);
    let names = found.into_iter().collect::<Vec<_>>().join(", ");
    let text = format!("Commands on the PATH (`wingd X` runs `wingd-X`): {names}");
    command.after_help(format!("{text}\n\n{}", about.unwrap_or_default()))
}

fn external_names(command: &Command) -> BTreeSet<String> {
    let entries = folders()
        .into_iter()
        .filter_map(|folder| std::fs::read_dir(folder).ok());
    entries
        .flat_map(|entries| entries.flatten())
        .filter_map(|entry| {
            let name = entry.file_name().to_str()?.strip_prefix(PREFIX)?.to_owned();
            let known = !is_name(&name) || is_built_in(command, &name);
            (!known && is_program(&entry.path())).then_some(name)
        })
        .collect()
}

fn is_name(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    !text.is_empty() && !text.starts_with('-') && text.chars().all(plain)
}

fn is_built_in(command: &Command, name: &str) -> bool {
    name == "help" || command.find_subcommand(name).is_some()
}

fn folders() -> Vec<PathBuf> {
    std::env::var_os("PATH").map_or_else(Vec::new, |path| std::env::split_paths(&path).collect())
}

fn find_program(name: &str) -> Option<PathBuf> {
    let mut places = folders()
        .into_iter()
        .map(|folder| folder.join(format!("{PREFIX}{name}")));
    places.find(|path| is_program(path))
}

fn is_program(path: &std::path::Path) -> bool {
    path.metadata()
        .is_ok_and(|about| about.is_file() && about.permissions().mode() & 0o111 != 0)
}
