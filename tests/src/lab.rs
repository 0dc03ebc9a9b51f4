//! The lab: Debian's own kernel in QEMU, where the drivers meet CAN buses and USB devices that this machine has not.
//!
//! The guest's first program, `tests/lab/init.sh`, makes this machine's files, read only, its root, so that it runs the
//! programs that were built here, with the libraries that are here. What `lab-guest` says of each case comes back by a
//! serial port. Nothing here is measured: the guest is emulated, about ten times slower than the machine.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use crate::{peers, programs, workspace_root};

/// Programs that the lab needs, and Debian's packages that have them.
const PROGRAMS: &[(&str, &str)] = &[
    ("qemu-system-x86_64", "qemu-system-x86"),
    ("busybox", "busybox-static"),
    ("cpio", "cpio"),
    ("modprobe", "kmod"),
    ("udevadm", "udev"),
    ("ip", "iproute2"),
];
/// Modules without which the guest cannot see this machine's files.
const FIRST_MODULES: &[&str] = &["virtio_pci", "9pnet_virtio", "9p"];
/// Parts of the kernel's package that the guest may need.
const KERNEL_PARTS: &[&str] = &[
    "./boot/vmlinuz-*",
    "./lib/modules/*/modules.*",
    "./lib/modules/*/kernel/crypto/*",
    "./lib/modules/*/kernel/lib/*",
    "./lib/modules/*/kernel/fs/*",
    "./lib/modules/*/kernel/net/9p/*",
    "./lib/modules/*/kernel/net/can/*",
    "./lib/modules/*/kernel/net/sched/*",
    "./lib/modules/*/kernel/drivers/hid/*",
    "./lib/modules/*/kernel/drivers/net/can/*",
    "./lib/modules/*/kernel/drivers/usb/*",
    "./lib/modules/*/kernel/drivers/virtio/*",
];
/// The guest is ended after this, s.
const LONGEST_S: &str = "420";

/// What the guest said: each case's name, and why it failed when it did.
pub type Verdicts = BTreeMap<String, Result<(), String>>;

/// What the guest says of all cases; it runs once for a test program. `None` after printing one line that says why not.
///
/// # Panics
/// `FT_REQUIRE_PEERS` is set and the guest cannot be run.
#[must_use]
pub fn verdicts() -> Option<&'static Verdicts> {
    static VERDICTS: OnceLock<Result<Verdicts, String>> = OnceLock::new();
    let required = std::env::var_os("FT_REQUIRE_PEERS").is_some();
    let run = || {
        let verdicts = run(required);
        if let Err(why) = &verdicts {
            let _ = writeln!(std::io::stderr(), "skipped: lab: {why}");
        }
        verdicts
    };
    match VERDICTS.get_or_init(run) {
        Ok(verdicts) => Some(verdicts),
        Err(why) => {
            assert!(!required, "lab: {why}");
            None
        }
    }
}

/// Asserts that the guest found `case` to hold; nothing when the lab is skipped.
///
/// # Panics
/// It did not.
pub fn holds(case: &str) {
    let Some(verdicts) = verdicts() else {
        return;
    };
    match verdicts.get(case) {
        Some(Ok(())) => {}
        Some(Err(why)) => panic!("{why}"),
        None => panic!(
            "the guest said nothing of it; it last said:\n{}",
            last_words(&folder())
        ),
    }
}

fn folder() -> PathBuf {
    workspace_root().join("target/lab")
}

fn last_words(folder: &Path) -> String {
    let console = std::fs::read(folder.join("console.txt")).unwrap_or_default();
    let console = String::from_utf8_lossy(&console);
    let lines: Vec<_> = console.lines().collect();
    lines[lines.len().saturating_sub(20)..].join("\n")
}

fn run(install: bool) -> Result<Verdicts, String> {
    if !cfg!(target_arch = "x86_64") {
        return Err("its guest is an x86-64 one".to_owned());
    }
    let folder = folder();
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let lock = std::fs::File::create(folder.join("lock")).map_err(|error| error.to_string())?;
    lock.lock().map_err(|error| error.to_string())?;
    have_programs(install)?;
    let kernel = kernel(&folder, install)?;
    let image = initial_files(&folder, &kernel)?;
    boot(&folder, &kernel, &image)
}

fn have_programs(install: bool) -> Result<(), String> {
    let missing = || {
        PROGRAMS
            .iter()
            .filter(|(program, _)| find(program).is_none())
            .map(|(_, package)| *package)
            .collect::<Vec<_>>()
    };
    let packages = missing();
    if packages.is_empty() {
        return Ok(());
    }
    if !install {
        return Err(format!("apt-get install {}", packages.join(" ")));
    }
    peers::install(&packages)?;
    match missing()[..] {
        [] => Ok(()),
        _ => Err(format!("apt installed no {}", missing().join(", no "))),
    }
}

fn find(program: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let system = ["/usr/sbin", "/sbin"].map(PathBuf::from);
    std::env::split_paths(&path)
        .chain(system)
        .map(|folder| folder.join(program))
        .find(|program| program.is_file())
}

/// A kernel of Debian's, unpacked.
struct Kernel {
    root: PathBuf,
    version: String,
}

fn kernel(folder: &Path, download: bool) -> Result<Kernel, String> {
    let root = folder.join("kernel");
    if !root.join("complete").exists() {
        if !download {
            return Err(format!(
                "no kernel is in {}: FT_REQUIRE_PEERS=1 downloads one",
                root.display()
            ));
        }
        unpack(folder, &root)?;
    }
    let version = version(&root)?;
    Ok(Kernel { root, version })
}

fn version(kernel: &Path) -> Result<String, String> {
    let mut versions = std::fs::read_dir(kernel.join("lib/modules"))
        .map_err(|error| error.to_string())?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let version = versions.next().ok_or("the kernel has no modules")?;
    Ok(version)
}

fn unpack(folder: &Path, root: &Path) -> Result<(), String> {
    let depends = said(Command::new("apt-cache").args(["depends", "linux-image-amd64"]))?;
    let package = depends
        .lines()
        .find_map(|line| line.trim().strip_prefix("Depends: "))
        .ok_or("apt knows no linux-image-amd64")?;
    said(
        Command::new("apt-get")
            .args(["download", "-qq", package])
            .current_dir(folder),
    )?;
    let downloaded = std::fs::read_dir(folder)
        .map_err(|error| error.to_string())?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| path.extension().is_some_and(|extension| extension == "deb"))
        .ok_or("apt downloaded no package")?;
    let _ = std::fs::remove_dir_all(root);
    std::fs::create_dir_all(root).map_err(|error| error.to_string())?;
    let mut package = Command::new("dpkg-deb")
        .arg("--fsys-tarfile")
        .arg(&downloaded)
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| format!("dpkg-deb: {error}"))?;
    let files = package.stdout.take().ok_or("dpkg-deb has no output")?;
    said(
        Command::new("tar")
            .args(["-x", "--wildcards", "-C"])
            .arg(root)
            .args(KERNEL_PARTS)
            .stdin(files),
    )?;
    package.wait().map_err(|error| error.to_string())?;
    let _ = std::fs::remove_file(downloaded);
    let depmod = find("depmod").ok_or("no depmod")?;
    said(Command::new(depmod).arg("-b").arg(root).arg(version(root)?))?;
    std::fs::write(root.join("complete"), "").map_err(|error| error.to_string())
}

/// The first files of the guest, packed: busybox, the modules of [`FIRST_MODULES`], `init`, and where things are.
fn initial_files(folder: &Path, kernel: &Kernel) -> Result<PathBuf, String> {
    let failed = |error: std::io::Error| error.to_string();
    let files = folder.join("initial");
    let _ = std::fs::remove_dir_all(&files);
    for directory in ["bin", "modules", "proc", "sys", "dev", "root"] {
        std::fs::create_dir_all(files.join(directory)).map_err(failed)?;
    }
    let busybox = find("busybox").ok_or("no busybox")?;
    std::fs::copy(busybox, files.join("bin/busybox")).map_err(failed)?;
    std::fs::copy(
        workspace_root().join("tests/lab/init.sh"),
        files.join("init"),
    )
    .map_err(failed)?;
    let mut order = Vec::new();
    for module in FIRST_MODULES {
        for path in modules(kernel, module)? {
            let name = path.file_name().unwrap_or_default().to_owned();
            if !order.contains(&name) {
                std::fs::copy(&path, files.join("modules").join(&name)).map_err(failed)?;
                order.push(name);
            }
        }
    }
    let order: Vec<_> = order.iter().map(|name| name.to_string_lossy()).collect();
    std::fs::write(files.join("modules/order"), order.join("\n")).map_err(failed)?;
    std::fs::write(files.join("lab.env"), environment(kernel)).map_err(failed)?;
    let image = folder.join("initial.gz");
    let script = "chmod 755 init && find . | cpio -o -H newc --quiet | gzip -1 > ../initial.gz";
    said(Command::new("sh").args(["-ec", script]).current_dir(&files))?;
    Ok(image)
}

/// The module files that `module` needs, itself the last.
fn modules(kernel: &Kernel, module: &str) -> Result<Vec<PathBuf>, String> {
    let modprobe = find("modprobe").ok_or("no modprobe")?;
    let listed = said(Command::new(modprobe).arg("-d").arg(&kernel.root).args([
        "-S",
        &kernel.version,
        "--show-depends",
        module,
    ]))?;
    let paths = listed
        .lines()
        .filter_map(|line| line.strip_prefix("insmod "))
        .map(|path| PathBuf::from(path.trim()));
    Ok(paths.collect())
}

/// What the guest's scripts must know, for a shell.
fn environment(kernel: &Kernel) -> String {
    let only = std::env::var("FT_LAB_ONLY").unwrap_or_default();
    let python = peers::can("lab").unwrap_or_else(|| Path::new(""));
    let quoted = |name: &str, value: &str| format!("{name}='{}'\n", value.replace('\'', "'\\''"));
    [
        ("FT_LAB_ROOT", workspace_root().to_string_lossy()),
        ("FT_LAB_KERNEL", kernel.root.to_string_lossy()),
        ("FT_LAB_BIN", programs::folder().to_string_lossy()),
        ("FT_LAB_ONLY", only.as_str().into()),
        ("FT_LAB_PYTHON", python.to_string_lossy()),
    ]
    .map(|(name, value)| quoted(name, &value))
    .concat()
}

fn boot(folder: &Path, kernel: &Kernel, image: &Path) -> Result<Verdicts, String> {
    let verdicts = folder.join("verdicts.txt");
    let _ = std::fs::remove_file(&verdicts);
    let console =
        std::fs::File::create(folder.join("console.txt")).map_err(|error| error.to_string())?;
    let vmlinuz = kernel
        .root
        .join("boot")
        .join(format!("vmlinuz-{}", kernel.version));
    let files = "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap";
    let status = Command::new("timeout")
        .args([LONGEST_S, "qemu-system-x86_64"])
        .args(["-accel", "tcg", "-m", "1024", "-smp", "2"])
        .args([
            "-display",
            "none",
            "-monitor",
            "none",
            "-no-reboot",
            "-nic",
            "none",
        ])
        .args(["-append", "console=ttyS0 quiet panic=-1"])
        .args(["-virtfs", files])
        .arg("-kernel")
        .arg(vmlinuz)
        .arg("-initrd")
        .arg(image)
        .args(["-serial", "stdio", "-serial"])
        .arg(format!("file:{}", verdicts.display()))
        .stdin(Stdio::null())
        .stdout(console.try_clone().map_err(|error| error.to_string())?)
        .stderr(console)
        .status()
        .map_err(|error| format!("qemu-system-x86_64: {error}"))?;
    let text = std::fs::read_to_string(&verdicts).unwrap_or_default();
    if !status.success() && text.is_empty() {
        return Err(format!(
            "the guest ended with {status}: {}",
            last_words(folder)
        ));
    }
    Ok(text.lines().filter_map(verdict).collect())
}

/// `case NAME ok` or `case NAME FAILED why`.
fn verdict(line: &str) -> Option<(String, Result<(), String>)> {
    let (name, said) = line.trim().strip_prefix("case ")?.split_once(' ')?;
    let verdict = match said.strip_prefix("FAILED") {
        Some(why) => Err(why.trim().to_owned()),
        None => Ok(()),
    };
    Some((name.to_owned(), verdict))
}

/// What a program says that ends well.
fn said(command: &mut Command) -> Result<String, String> {
    let output = command
        .output()
        .map_err(|error| format!("{command:?}: {error}"))?;
    if !output.status.success() {
        let why = String::from_utf8_lossy(&output.stderr).into_owned();
        return Err(format!("{command:?}: {}", why.trim()));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
