//! The program `radcam`.

fn main() -> std::process::ExitCode {
    radcam::cli::main()
}
