//! The `isospan` program.

fn main() -> std::process::ExitCode {
    isospan_cli::commands::program().into()
}
