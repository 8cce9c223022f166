//! Plots and sweeps: the front and the ticks on paper cases, the files parsed back.

use comgs_pipeline::PipelineError;
use comgs_pipeline::plot::{
    Better, Chart, PNG_SCALE, Panel, Point, Scale, Series, WIDTH, pareto_front, ticks,
};
use comgs_pipeline::tradeoff::{Metric, Row, Sweep, describe_machine, machine};
use resvg::usvg::roxmltree::Document;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

fn metric(key: &str, label: &str, unit: &str, better: Better, digits: usize) -> Metric {
    Metric { key: key.to_owned(), label: label.to_owned(), unit: unit.to_owned(), better, digits }
}

fn row(group: &str, label: &str, is_default: bool, seconds: f64, values: [f64; 3]) -> Row {
    let keys = ["albedo_psnr", "relit_psnr", "memory"].map(str::to_owned);
    let values = BTreeMap::from_iter(keys.into_iter().zip(values));
    Row { group: group.to_owned(), label: label.to_owned(), is_default, seconds, values }
}

/// A sweep of the size and crowding of `comgs ablate decompose`: one default run that is a row of all six knobs.
fn sweep() -> Sweep {
    let default = [27.6, 28.9, 41.0];
    let rows = vec![
        row("offset", "0 %", false, 138.0, [26.1, 27.2, 41.0]),
        row("offset", "1 %", true, 140.0, default),
        row("offset", "2 %", false, 141.0, [27.4, 28.5, 41.0]),
        row("probes", "1k", false, 96.0, [26.8, 27.9, 12.0]),
        row("probes", "5k", true, 140.0, default),
        row("probes", "10k", false, 187.0, [27.7, 29.0, 79.0]),
        row("texture", "8²", false, 121.0, [27.1, 28.2, 19.0]),
        row("texture", "16²", true, 140.0, default),
        row("texture", "32²", false, 214.0, [27.65, 28.95, 131.0]),
        row("rays", "32", false, 78.0, [26.9, 28.4, 41.0]),
        row("rays", "128", true, 140.0, default),
        row("rays", "512", false, 402.0, [27.8, 29.1, 41.0]),
        row("Chebyshev", "on", true, 140.0, default),
        row("Chebyshev", "off", false, 136.0, [27.3, 28.6, 36.0]),
        row("visibility", "none", false, 41.0, [24.2, 25.1, 4.0]),
        row("visibility", "probes", true, 140.0, default),
        row("visibility", "trace", false, 1210.0, [27.9, 29.2, 8.0]),
    ];
    Sweep {
        title: "Decomposing the teapot: what each choice costs".to_owned(),
        command:
            "comgs ablate decompose $P/object/teapot --iterations 600 --repeats 3 --light $P/light/field.exr \
                  -o docs/cost --knobs offset,probes,texture,rays,chebyshev,visibility"
                .to_owned(),
        machine: describe_machine("model name\t: Some  CPU @ 2.1GHz\n", 2, 2),
        metrics: vec![
            metric("albedo_psnr", "albedo PSNR, aligned", "dB", Better::Up, 2),
            metric("relit_psnr", "relighting PSNR", "dB", Better::Up, 2),
            metric("memory", "memory", "MB", Better::Down, 0),
        ],
        rows,
    }
}

fn texts(svg: &str) -> Vec<String> {
    let document = Document::parse(svg).expect("well-formed XML");
    let texts = document.descendants().filter(|n| n.has_tag_name("text"));
    texts.map(|n| n.text().unwrap_or_default().to_owned()).collect()
}

fn decode(png: &[u8]) -> image::RgbImage {
    let decoded = image::load_from_memory_with_format(png, image::ImageFormat::Png).expect("a PNG");
    assert_eq!(decoded.color(), image::ColorType::Rgb8);
    decoded.into_rgb8()
}

/// Goal: the front of cases worked out on paper: dominated, equal, tied in one coordinate, not finite, both directions.
#[test]
fn pareto_front_on_paper() {
    let points =
        [(3.0, 5.0), (1.0, 1.0), (2.0, 4.0), (2.5, 3.0), (4.0, 5.0), (f64::NAN, 9.0), (0.5, f64::INFINITY)];
    assert_eq!(pareto_front(&points, Better::Up), [1, 2, 0]);
    // For a measure to be made small, the fastest point has also the least.
    assert_eq!(pareto_front(&points, Better::Down), [1]);
    assert_eq!(pareto_front(&[(1.0, 2.0), (1.0, 3.0), (2.0, 3.0)], Better::Up), [1]);
    assert_eq!(pareto_front(&[(1.0, 2.0), (1.0, 2.0)], Better::Up), [0]);
    assert_eq!(pareto_front(&[(1.0, 9.0), (2.0, 4.0), (3.0, 4.0), (4.0, -1.0)], Better::Down), [0, 1, 3]);
    assert!(pareto_front(&[], Better::Up).is_empty());
    // Brute force over a lattice with many ties.
    let lattice: Vec<(f64, f64)> = (0..60).map(|i| (f64::from(i * 7 % 9), f64::from(i * 11 % 13))).collect();
    let beaten = |a: (f64, f64)| lattice.iter().any(|&b| b.0 <= a.0 && b.1 >= a.1 && b != a);
    let expected: BTreeSet<_> =
        lattice.iter().filter(|p| !beaten(**p)).map(|p| (p.0 as i64, p.1 as i64)).collect();
    let front = pareto_front(&lattice, Better::Up);
    let got: BTreeSet<_> = front.iter().map(|&i| (lattice[i].0 as i64, lattice[i].1 as i64)).collect();
    assert_eq!((got.len(), got), (front.len(), expected));
}

/// Goal: ticks are 1, 2 or 5 times a power of ten, no more than asked, written with the decimals they need.
#[test]
fn ticks_are_round() {
    let labels = |low, high, scale, most| ticks(low, high, scale, most).labels;
    assert_eq!(labels(0.0, 10.0, Scale::Linear, 6), ["0", "2", "4", "6", "8", "10"]);
    assert_eq!(labels(26.85, 27.4, Scale::Linear, 6), ["26.9", "27.0", "27.1", "27.2", "27.3", "27.4"]);
    assert_eq!(labels(-1.2, 1.2, Scale::Linear, 4), ["−1", "0", "1"]);
    assert_eq!(labels(0.0, 0.31, Scale::Linear, 4), ["0.0", "0.1", "0.2", "0.3"]);
    assert_eq!(ticks(0.0, 0.31, Scale::Linear, 4).values, [0.0, 0.1, 0.2, 0.3]);
    assert_eq!(labels(0.0, 14_000.0, Scale::Linear, 4), ["0", "5,000", "10,000"]);
    assert_eq!(labels(0.03, 2.2, Scale::Log, 8), ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
    assert_eq!(labels(0.03, 2e4, Scale::Log, 8), ["0.1", "1", "10", "100", "1,000", "10,000"]);
    assert_eq!(labels(1e-3, 1e5, Scale::Log, 5), ["0.001", "0.1", "10", "1,000", "100,000"]);
    // Within a factor of two there are no three of 1, 2, 5: linear steps.
    assert_eq!(labels(11.0, 15.0, Scale::Log, 5), ["11", "12", "13", "14", "15"]);
    for (low, high, scale) in
        [(1.0, 1.0, Scale::Linear), (f64::NAN, 1.0, Scale::Linear), (0.0, 1.0, Scale::Log)]
    {
        assert!(labels(low, high, scale, 5).is_empty());
    }
    for k in -40..40 {
        let high = 1.37f64.powi(k);
        for most in 2..9 {
            let count = ticks(0.0, high, Scale::Linear, most).values.len();
            assert!((1..=most).contains(&count), "{count} of {most} ticks on 0..{high}");
        }
    }
}

/// Goal: the SVG of a real-sized sweep is well-formed, has panels, knobs, units, command and machine, and every label.
#[test]
fn svg_says_everything() {
    let sweep = sweep();
    let svg = sweep.to_chart().unwrap().to_svg();
    let texts = texts(&svg);
    let whole = texts.join(" ");
    for expected in [
        "Decomposing the teapot: what each choice costs",
        "albedo PSNR, aligned (dB)",
        "memory (MB)",
        "↑ higher is better",
        "↓ lower is better",
        "time (s), logarithmic",
        "probes (default 5k)",
        "Command: comgs ablate decompose",
        "Machine: Some CPU @ 2.1GHz, 2 threads on 2 logical cores",
    ] {
        assert!(whole.contains(expected), "“{expected}” is missing");
    }
    for row in sweep.rows.iter().filter(|r| !r.is_default) {
        let count = texts.iter().filter(|t| **t == row.label).count();
        assert!(count >= 3, "{} {} is on {count} of 3 panels", row.group, row.label);
    }
    // Six default rows on one spot share a label, in each of three panels; the fourth is the legend's.
    assert_eq!(texts.iter().filter(|t| *t == "default").count(), 4);
    assert!(!whole.contains("No room"));
    assert_eq!(svg, sweep.to_chart().unwrap().to_svg());
}

/// Goal: the PNG has the SVG's size times the scale, opaque white corners, and the colours of the marks.
#[test]
fn png_is_the_same_picture() {
    let chart = sweep().to_chart().unwrap();
    let svg = chart.to_svg();
    let document = Document::parse(&svg).unwrap();
    let side = |name: &str| document.root_element().attribute(name).unwrap().parse::<f64>().unwrap();
    assert_eq!(side("width"), WIDTH);
    for scale in [1.0, PNG_SCALE] {
        let picture = decode(&chart.to_png(scale).unwrap());
        let expected = (f64::from(picture.width()), f64::from(picture.height()));
        assert_eq!(expected, ((side("width") * scale).round(), (side("height") * scale).round()));
        assert_eq!(picture.get_pixel(0, 0).0, [255; 3]);
        let colors: BTreeSet<[u8; 3]> = picture.pixels().map(|p| p.0).collect();
        for mark in [[0x00, 0x72, 0xb2], [0xd5, 0x5e, 0x00], [0x00, 0x9e, 0x73]] {
            assert!(colors.contains(&mark), "no pixel of {mark:?}");
        }
    }
}

/// Goal: text is drawn without any font of the system: a chart with another title has other pixels in its first lines.
#[test]
fn text_is_drawn() {
    let ink = |title: &str| {
        let chart = Chart { title: title.to_owned(), ..sweep().to_chart().unwrap() };
        let picture = decode(&chart.to_png(1.0).unwrap());
        picture.enumerate_pixels().filter(|(_, y, p)| *y < 48 && p.0[0] < 128).count()
    };
    let (long, short) = (ink("MMMMMMMM ² ° → ≥ × “µ”"), ink("i"));
    assert!(long > 20 * short && short > 0, "{long} dark pixels against {short}");
}

/// Goal: markup in names reaches the reader as text, in SVG, Markdown and CSV.
#[test]
fn names_are_escaped() {
    let mut sweep = sweep();
    sweep.title = "a < b & \"c\" > <script>|x|\u{1}".to_owned();
    sweep.rows[0].label = "<&>".to_owned();
    sweep.rows[0].group = "off,set \"q\"".to_owned();
    sweep.command = "comgs `x` | y".to_owned();
    let svg = sweep.to_chart().unwrap().to_svg();
    let texts = texts(&svg);
    assert!(texts.contains(&"a < b & \"c\" > <script>|x|\u{fffd}".to_owned()));
    assert!(texts.iter().filter(|t| *t == "<&>").count() >= 3);
    assert!(!svg.contains("<script"));
    sweep.to_chart().unwrap().to_png(1.0).unwrap();
    let markdown = sweep.to_markdown().unwrap();
    assert!(markdown.starts_with("## a \\< b & \"c\" \\> \\<script\\>\\|x\\|"));
    assert!(markdown.contains("Command: `` comgs `x` | y ``"));
    assert!(sweep.to_csv().unwrap().contains("\n\"off,set \"\"q\"\"\",<&>,false,138,26.1,27.2,41\n"));
}

/// Goal: what has no finite value is left out of the plot and said, a dash in the table, empty in the CSV.
#[test]
fn not_a_number_is_left_out_and_said() {
    let mut sweep = sweep();
    sweep.rows[3].values.insert("albedo_psnr".to_owned(), f64::NAN);
    sweep.rows[5].values.remove("relit_psnr");
    sweep.rows[16].seconds = f64::INFINITY;
    let svg = sweep.to_chart().unwrap().to_svg();
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
    let caption = texts(&svg).join(" ");
    let said = "Not drawn in “albedo PSNR, aligned (dB)”, no usable value: probes 1k, visibility trace.";
    assert!(caption.contains(said), "{caption}");
    assert!(caption.contains("Not drawn in “relighting PSNR (dB)”, no usable value: probes 10k,"));
    let markdown = sweep.to_markdown().unwrap();
    assert!(markdown.contains("| probes | 1k | 96.0 | – | 27.90 | 12 |"), "{markdown}");
    assert!(markdown.contains("|  | trace | – | 27.90 | 29.20 | 8 |"));
    let csv = sweep.to_csv().unwrap();
    assert!(
        csv.contains("\nprobes,1k,false,96,,27.9,12\n")
            && csv.contains("\nvisibility,trace,false,,27.9,29.2,8\n")
    );
    // A metric that no run has: the panel says so, the others stand.
    sweep.metrics.push(metric("ssim", "SSIM", "", Better::Up, 3));
    assert!(texts(&sweep.to_chart().unwrap().to_svg()).contains(&"no values to draw".to_owned()));
}

/// Goal: zero seconds have no place on a logarithmic axis: left out and said, not at minus infinity.
#[test]
fn zero_on_a_logarithmic_axis() {
    let point = |x: f64, label: &str| Point { x, y: 1.0, label: label.to_owned(), is_default: false };
    let series = Series { name: "s".to_owned(), points: vec![point(0.0, "nil"), point(1.0, "one")] };
    let panel = Panel { y_title: "y".to_owned(), better: Better::Up, joined: false, series: vec![series] };
    let chart = Chart {
        title: "t".to_owned(),
        caption: Vec::new(),
        x_title: "time (s)".to_owned(),
        x_scale: Scale::Log,
        panels: vec![panel],
    };
    let svg = chart.to_svg();
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
    assert!(texts(&svg).contains(&"Not drawn in “y”, no usable value: s nil.".to_owned()));
}

/// Goal: a sweep without anything to show is refused in words by every output, and writes nothing.
#[test]
fn empty_and_wrong_sweeps_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |change: fn(&mut Sweep), words: &str| {
        let mut sweep = sweep();
        change(&mut sweep);
        let errors = [
            sweep.to_csv().err(),
            sweep.to_markdown().err(),
            sweep.to_chart().err(),
            sweep.write(folder.path(), "x").err(),
        ];
        for error in errors {
            let error = error.unwrap_or_else(|| panic!("{words}: not refused"));
            assert!(matches!(error, PipelineError::Input { .. }));
            assert!(error.to_string().contains(words), "{error}");
        }
    };
    refused(|s| s.rows.clear(), "expected at least one run, got none");
    refused(|s| s.metrics.clear(), "expected at least one metric");
    refused(|s| s.metrics[1].key = "albedo_psnr".to_owned(), "albedo_psnr twice");
    refused(|s| s.rows.iter_mut().for_each(|r| r.seconds = f64::NAN), "17 without");
    refused(|s| s.rows[2].seconds = -1.0, "-1 for offset 2 %");
    refused(|s| s.rows[1].values.extend([("albdo".to_owned(), 1.0)]), "“albdo” in offset 1 %");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// Goal: the four files are there, the table is grouped with its defaults marked, and rows of a group that are apart in
/// the sweep are together in the table.
#[test]
fn write_makes_four_files() {
    let folder = tempfile::tempdir().unwrap();
    let mut sweep = sweep();
    let last = sweep.rows.remove(0);
    sweep.rows.push(last);
    let paths = sweep.write(&folder.path().join("deep"), "ablate decompose").unwrap();
    for (path, extension) in paths.iter().zip(["csv", "md", "svg", "png"]) {
        assert!(path.ends_with(Path::new(&format!("deep/ablate decompose.{extension}"))));
        assert!(std::fs::metadata(path).unwrap().len() > 100);
    }
    let markdown = std::fs::read_to_string(&paths[1]).unwrap();
    let head = "| knob | value | seconds ↓ | albedo PSNR, aligned (dB) ↑ | relighting PSNR (dB) ↑ | memory (MB) ↓ |\n\
                |---|---|---:|---:|---:|---:|\n\
                | offset | **1 %** (default) | 140 | 27.60 | 28.90 | 41 |\n\
                |  | 2 % | 141 | 27.40 | 28.50 | 41 |\n\
                |  | 0 % | 138 | 26.10 | 27.20 | 41 |\n\
                | probes | 1k | 96.0 | 26.80 | 27.90 | 12 |\n";
    assert!(markdown.contains(head), "{markdown}");
    assert!(markdown.contains("| visibility | none | 41.0 |") && markdown.contains("|  | trace | 1,210 |"));
    assert!(
        markdown.ends_with("\n![Decomposing the teapot: what each choice costs](<ablate decompose.svg>)\n")
    );
    let csv = std::fs::read_to_string(&paths[0]).unwrap();
    assert!(csv.starts_with(
        "group,label,default,seconds,albedo_psnr,relit_psnr,memory\noffset,1 %,true,140,27.6,28.9,41\n"
    ));
    assert_eq!(csv.lines().count(), 1 + sweep.rows.len());
    // Kept for looking at: target/tmp/.
    let kept = Path::new(env!("CARGO_TARGET_TMPDIR"));
    sweep.write(kept, "sweep").unwrap();
    let few = Sweep {
        rows: sweep
            .rows
            .iter()
            .filter(|r| ["rays", "visibility"].contains(&r.group.as_str()))
            .cloned()
            .collect(),
        ..sweep.clone()
    };
    few.write(kept, "sweep_two_knobs").unwrap();
    let one = Sweep { metrics: sweep.metrics[1..2].to_vec(), rows: strip(&sweep.rows[..8]), ..sweep };
    one.write(kept, "sweep_one_metric").unwrap();
}

/// Rows with the relighting score only.
fn strip(rows: &[Row]) -> Vec<Row> {
    let only = |row: &Row| Row {
        values: row.values.clone().into_iter().filter(|(key, _)| key == "relit_psnr").collect(),
        ..row.clone()
    };
    rows.iter().map(only).collect()
}

/// Goal: the machine is named by its processor, or by its architecture where there is no such file, and never by its
/// host name.
#[test]
fn machine_is_described() {
    let info = "processor\t: 0\nmodel name\t:  Big   CPU 9000 \nmodel name\t: other\n";
    assert_eq!(
        describe_machine(info, 1, 8),
        "Big CPU 9000, 1 thread on 8 logical cores, which other programs may share"
    );
    assert!(describe_machine("", 2, 4).starts_with(std::env::consts::ARCH));
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = host.trim();
    assert!(host.len() < 4 || !machine().contains(host));
}
