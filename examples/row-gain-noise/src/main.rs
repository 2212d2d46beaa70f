//! radcam with one additional effect: `cargo run -p row-gain-noise -- effects row-gain-noise`.

fn main() -> std::process::ExitCode {
    if let Err(taken) = radcam_sim::effects::register(&row_gain_noise::RowGainNoise) {
        unreachable!("{taken}: the catalogue has no effect of this name");
    }
    radcam::cli::main()
}
