//! volseggs with seven extensions. Every command works as in the program itself; configurations know the new names.

mod densification;
mod encoder;
mod exporter;
mod loss;
mod method;
mod metric;
mod schedule;

/// The program's own allocator, so that training times are comparable.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    volseggs::extend::loss_term("edges", loss::Edges);
    volseggs::extend::encoder("waves", encoder::Waves { frequency: 3.0 });
    volseggs::extend::encoder("fast-waves", encoder::Waves { frequency: 9.0 });
    volseggs::extend::schedule("warm-cosine", schedule::WarmCosine { warm: 0.05, last: 0.01 });
    volseggs::extend::densification("opaque", densification::Opaque { opacity: 0.1 });
    volseggs::extend::metric("foreground_psnr", metric::ForegroundPsnr);
    volseggs::extend::exporter(exporter::XYZ);
    volseggs::extend::method("pixels", method::Pixels);
    volseggs::main()
}
