//! The built binary: help that teaches, wrong usage, errors as sentences, exit codes.

use std::path::Path;
use std::process::{Command, Output};

fn comgs(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_comgs"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the binary that cargo has just built")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

const COMMANDS: [&str; 22] = [
    "reconstruct",
    "decompose",
    "relight",
    "material",
    "place",
    "light",
    "panorama",
    "model",
    "render",
    "compose",
    "insert",
    "insert-eval",
    "shadow",
    "plan",
    "animate",
    "tradeoff",
    "eval",
    "ablate",
    "export",
    "synth",
    "demo",
    "info",
];

/// Goal: help lists every command with a sentence and shows the whole way; each command's help has examples that begin
/// with the command itself.
#[test]
fn help_teaches() {
    let folder = tempfile::tempdir().unwrap();
    let help = comgs(&["--help"], folder.path());
    assert!(help.status.success());
    let help = text(&help.stdout);
    for command in COMMANDS {
        let line = help.lines().find(|l| l.trim_start().starts_with(command)).unwrap_or_default();
        assert!(line.trim().len() > command.len() + 10, "{command}: {line:?}");
        let own = comgs(&[command, "--help"], folder.path());
        assert!(own.status.success());
        let own = text(&own.stdout);
        assert!(own.contains("Examples:") && own.contains(&format!("\n  comgs {command} ")), "{own}");
        assert!(own.contains("--threads") && own.contains("--quiet"), "{own}");
        let short = text(&comgs(&[command, "-h"], folder.path()).stdout);
        assert!(short.contains("Examples:"), "{short}");
    }
    assert!(help.contains("comgs compose --scene room.asset"));
    assert_eq!(
        text(&comgs(&["--version"], folder.path()).stdout).trim(),
        format!("comgs {}", env!("CARGO_PKG_VERSION"))
    );
}

/// Goal: the synopsis of the project's plan holds: every flag that is promised is there.
#[test]
fn promised_flags_exist() {
    let folder = tempfile::tempdir().unwrap();
    for (command, flags) in [
        (
            "reconstruct",
            &[
                "--output",
                "--kind",
                "--quality",
                "--time-budget",
                "--seed",
                "--resume",
                "--check",
                "--budget-surfels",
            ][..],
        ),
        ("place", &["--scene", "--object", "--at", "--pixel", "--size", "--yaw", "--output"]),
        ("light", &["--scene", "--at", "--output", "--completion"]),
        (
            "render",
            &["--cameras", "--output", "--layers", "--composition", "--shadow", "--tolerance", "--budget"],
        ),
        ("shadow", &["--composition", "--output"]),
        ("plan", &["--composition", "--tolerance", "--budget"]),
        ("animate", &["--composition", "--path", "--output"]),
        ("compose", &["--scene", "--object", "--transform", "--cameras", "--output", "--layers"]),
        ("eval", &["--against", "--json"]),
        ("synth", &["--output"]),
        ("demo", &["--output"]),
        ("export", &["--output", "--viewer"]),
    ] {
        let help = text(&comgs(&[command, "--help"], folder.path()).stdout);
        for flag in flags {
            assert!(help.contains(flag), "{command} {flag}");
        }
    }
}

/// Goal: wrong usage exits with 2 and says what is expected.
#[test]
fn wrong_usage_is_2() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        (&[][..], "Usage"),
        (&["paint"], "unrecognized subcommand"),
        (&["reconstruct", "capture"], "--output"),
        (&["reconstruct", "c", "-o", "a", "--time-budget", "soon"], "90s, 5m"),
        (&["reconstruct", "c", "-o", "a", "--quality", "best"], "balanced"),
        (&["place", "--scene", "s", "--object", "o", "-o", "t.json"], "--at"),
        (&["place", "--scene", "s", "--object", "o", "-o", "t.json", "--at", "1,2"], "x,y,z"),
        (
            &["place", "--scene", "s", "--object", "o", "-o", "t", "--at", "1,2,3", "--pixel", "v,1,2"],
            "cannot be used",
        ),
        (&["place", "--scene", "s", "--object", "o", "-o", "t", "--pixel", "v,1"], "view,x,y"),
        (&["place", "--scene", "s", "--object", "o", "-o", "t", "--at", "1,2,3", "--size", "-1"], "positive"),
        (&["place", "--scene", "s", "--object", "o", "-o", "t", "--at", "1,2,3", "--yaw", "inf"], "finite"),
        (&["place", "--scene", "s", "--object", "o", "-o", "t", "--at", "1,2,3", "--yaw", "nan"], "finite"),
        (&["light", "--scene", "s", "--at", "1,2,3", "-o", "e.exr", "--near", "-1"], "negative"),
        (&["compose", "--scene", "s", "--transform", "t", "--cameras", "c", "-o", "out"], "--object"),
        (&["render", "-o", "out"], "--composition"),
        (&["render", "a.asset", "-o", "out"], "--cameras"),
        (&["render", "--composition", "c.json", "--budget", "soon", "-o", "out"], "90s, 5m"),
        (&["plan", "--composition", "c.json", "--tolerance", "-1"], "positive"),
        (&["synth", "tiny"], "-o ROOT"),
        (&["info"], "PATHS"),
        (&["demo", "--threads", "0"], "1 to 1024"),
    ] {
        let output = comgs(arguments, folder.path());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(expected), "{arguments:?}: {}", text(&output.stderr));
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "wrong usage writes nothing");
}

/// Goal: failures exit with 1 and one sentence on standard error that ends with the path; nothing is printed as a result
/// and nothing is written.
#[test]
fn failures_are_1_and_name_the_path() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    std::fs::create_dir(root.join("empty")).unwrap();
    std::fs::write(root.join("broken.ply"), b"ply\nformat ascii 1.0\nelement vertex 9999999999\n").unwrap();
    std::fs::write(root.join("broken.json"), b"{\"a\": ").unwrap();
    std::fs::write(root.join("note.txt"), b"hello").unwrap();
    let before = std::fs::read_dir(root).unwrap().count();
    for (arguments, expected) in [
        (&["reconstruct", "missing", "-o", "a.asset"][..], "missing"),
        (&["reconstruct", "empty", "-o", "a.asset"], "empty"),
        (&["info", "missing"], "missing"),
        (&["info", "broken.ply"], "broken.ply"),
        (&["info", "broken.json"], "broken.json"),
        (&["info", "note.txt"], "note.txt"),
        (&["info", "empty"], "empty"),
        (&["render", "broken.ply", "--cameras", "broken.json", "-o", "out"], "broken"),
        (&["render", "empty", "--cameras", "broken.json", "-o", "out"], "broken"),
        (&["light", "--scene", "broken.ply", "--at", "0,0,-1", "-o", "env.exr"], "broken.ply"),
        (
            &["place", "--scene", "empty", "--object", "empty", "--at", "-1,0,0", "-o", "t.json"],
            "comgs reconstruct",
        ),
        (
            &[
                "compose",
                "--scene",
                "empty",
                "--object",
                "empty",
                "--transform",
                "broken.json",
                "--cameras",
                "empty",
                "-o",
                "out",
            ],
            "broken.json",
        ),
        (&["eval", "empty", "--against", "empty"], "empty"),
        (&["light", "--scene", "broken.ply", "--at", "0,0,-1", "-o", "l.png"], ".exr or .hdr"),
        (&["render", "broken.ply", "--cameras", "broken.json", "-o", "note.txt/out"], "broken.json"),
        (
            &["light", "--scene", "broken.ply", "--at", "0,0,1", "-o", "note.txt/e.exr"],
            "output folder note.txt",
        ),
        (&["export", "broken.ply", "-o", "out.obj"], ".ply"),
        (&["synth", "castle", "-o", "out"], "tiny"),
        (&["demo", "--assets", "nowhere", "-o", "out"], "nowhere"),
    ] {
        let output = comgs(arguments, root);
        let (out, error) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {error}");
        assert!(error.contains("error: ") && error.contains(expected), "{arguments:?}: {error}");
        assert!(out.is_empty(), "{arguments:?}: {out}");
        assert!(!error.contains("panicked"), "{arguments:?}: {error}");
    }
    assert_eq!(std::fs::read_dir(root).unwrap().count(), before, "failures leave nothing behind");
}

/// Goal: `info` goes on after a path that it cannot understand, says which one that was, and exits with 1 at the end.
#[test]
fn info_goes_on_after_a_bad_path() {
    let folder = tempfile::tempdir().unwrap();
    let record = r#"{"cow": {"transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}"#;
    std::fs::write(folder.path().join("transform.json"), record).unwrap();
    std::fs::write(folder.path().join("note.txt"), b"hello").unwrap();
    let output = comgs(&["info", "missing", "transform.json", "note.txt"], folder.path());
    let (out, error) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(out.contains("placement") && out.contains("cow"), "{out}");
    assert!(error.contains("missing") && error.contains("note.txt"), "{error}");
    assert_eq!(error.matches("error: ").count(), 2, "{error}");
}

/// Goal: a reader that closes standard output early (`comgs … | head -1`) is no failure: quiet, and exit code 0.
#[cfg(unix)]
#[test]
fn a_closed_pipe_ends_quietly() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["synth", "list"][..], &["info", "transform.json"]] {
        let record = r#"{"cow": {"transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}"#;
        std::fs::write(folder.path().join("transform.json"), record).unwrap();
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = Command::new(env!("CARGO_BIN_EXE_comgs"))
            .args(arguments)
            .current_dir(folder.path())
            .stdout(writer)
            .output()
            .unwrap();
        assert!(output.status.success(), "{arguments:?}: {:?}", output.status);
        assert_eq!(text(&output.stderr), "", "{arguments:?}");
    }
}

/// Goal: `--check` lists every problem of a capture at once and exits with 1; a sound capture exits with 0.
#[test]
fn check_lists_everything_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let made = comgs(
        &["synth", "micro", "-o", "root", "--samples", "1", "--quiet", "--threads", "1"],
        folder.path(),
    );
    assert!(made.status.success(), "{}", text(&made.stderr));
    assert!(text(&made.stderr).is_empty(), "--quiet is quiet: {}", text(&made.stderr));
    let objects = folder.path().join("root/object");
    let object = std::fs::read_dir(&objects).unwrap().next().unwrap().unwrap().path();
    let capture = object.to_str().unwrap();
    let sound = comgs(&["reconstruct", "--check", capture], folder.path());
    assert!(sound.status.success(), "{}", text(&sound.stdout));

    let images = object.join("train/images");
    let mut files: Vec<_> = std::fs::read_dir(&images).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    std::fs::remove_file(&files[0]).unwrap();
    std::fs::write(&files[1], b"no picture").unwrap();
    let broken = comgs(&["reconstruct", "--check", capture], folder.path());
    let listed = text(&broken.stdout);
    for file in &files[..2] {
        // A missing image is known by its place in the list, without an extension.
        assert!(listed.contains(file.with_extension("").to_str().unwrap()), "{listed}");
    }
    // Looking at the capture says the same and does not fail: info is for looking.
    let info = comgs(&["info", capture], folder.path());
    assert!(info.status.success() && text(&info.stdout).contains("SynCom"), "{}", text(&info.stderr));
}

/// Goal: a Ctrl-C ends a stage at a resumable state with exit code 130.
#[cfg(unix)]
#[test]
fn interrupt_is_130() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_comgs"))
        .args(["synth", "room", "-o", "root", "--samples", "256"])
        .current_dir(folder.path())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    std::thread::sleep(std::time::Duration::from_millis(700));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let start = std::time::Instant::now();
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    assert!(start.elapsed().as_secs() < 60, "{:?}", start.elapsed());
}
