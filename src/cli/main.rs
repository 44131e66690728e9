//! The `isospan` program.

fn main() -> std::process::ExitCode {
    isospan_cli::commands::main(std::env::args_os()).into()
}
