//! Finds Embree and OpenImageIO, binds their installed headers and compiles the shims of `ffi/`.

use std::env;
use std::path::{Path, PathBuf};
use std::process::exit;

fn main() {
    for file in ["embree.h", "embree_shim.c", "oiio_shim.h", "oiio_shim.cpp"] {
        println!("cargo::rerun-if-changed=ffi/{file}");
    }
    println!("cargo::rerun-if-changed=build.rs");
    for variable in ["EMBREE_DIR", "OIIO_DIR"] {
        println!("cargo::rerun-if-env-changed={variable}");
    }
    compiler();
    need_libclang();
    embree();
    oiio();
}

/// Ends the build with one line that says what to do.
fn fail(message: &str) -> ! {
    println!("cargo::error={}", message.replace('\n', "; "));
    // The line alone fails the build. A failing exit code would bury it in all that was printed.
    exit(0)
}

/// Tells the program which compiler made it, for the records of benchmarks.
fn compiler() {
    let rustc = env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = std::process::Command::new(rustc).arg("--version").output();
    let version = output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_string()).unwrap_or_default();
    println!("cargo::rustc-env=TWOPASS_RUSTC={version}");
}

/// bindgen itself panics with a page of text where libclang is missing.
fn need_libclang() {
    std::panic::set_hook(Box::new(|_| ()));
    let found = std::panic::catch_unwind(bindgen::clang_version).is_ok();
    let _ = std::panic::take_hook();
    if !found {
        fail("libclang was not found: install the package libclang-dev, or set LIBCLANG_PATH to its folder");
    }
}

/// A library's headers and where to link it from.
struct Library {
    include: Vec<PathBuf>,
    link: Vec<PathBuf>,
}

impl Library {
    /// The library under a prefix that the user named.
    fn under(prefix: &Path) -> Library {
        let mut link: Vec<PathBuf> = ["lib", "lib64"].iter().map(|d| prefix.join(d)).collect();
        if let (Ok(arch), Ok(os)) = (env::var("CARGO_CFG_TARGET_ARCH"), env::var("CARGO_CFG_TARGET_OS")) {
            link.push(prefix.join(format!("lib/{arch}-{os}-gnu")));
        }
        link.retain(|d| d.is_dir());
        Library { include: vec![prefix.join("include")], link }
    }

    fn has(&self, header: &str) -> bool {
        self.include.iter().any(|d| d.join(header).is_file())
    }

    /// Asks pkg-config, then looks in the usual places.
    fn installed(package: &str, header: &str) -> Option<Library> {
        let probe = pkg_config::Config::new().cargo_metadata(false).env_metadata(true).probe(package);
        if let Ok(found) = probe {
            return Some(Library { include: found.include_paths, link: found.link_paths });
        }
        // The system's own prefix is searched by every compiler and linker without being named.
        if Path::new("/usr/include").join(header).is_file() {
            return Some(Library { include: vec![], link: vec![] });
        }
        ["/usr/local", "/opt/homebrew", "/opt/local"]
            .iter()
            .map(|prefix| Library::under(Path::new(prefix)))
            .find(|library| library.has(header))
    }

    fn link(&self, names: &[&str]) {
        for dir in &self.link {
            println!("cargo::rustc-link-search=native={}", dir.display());
            println!("cargo::rustc-link-arg=-Wl,-rpath,{}", dir.display());
        }
        for name in names {
            println!("cargo::rustc-link-lib=dylib={name}");
        }
    }
}

/// The prefix in an environment variable, where it is set.
fn prefix(variable: &str) -> Option<PathBuf> {
    env::var_os(variable).filter(|v| !v.is_empty()).map(PathBuf::from)
}

fn embree() {
    let header = |major: u32| format!("embree{major}/rtcore.h");
    let found = match prefix("EMBREE_DIR") {
        Some(dir) => {
            let library = Library::under(&dir);
            let Some(major) = [4, 3].into_iter().find(|&m| library.has(&header(m))) else {
                fail(&format!("EMBREE_DIR={} holds no include/embree4/rtcore.h (or embree3)", dir.display()));
            };
            Some((major, library))
        }
        None => [4, 3]
            .into_iter()
            .find_map(|m| Library::installed(&format!("embree{m}"), &header(m)).map(|library| (m, library))),
    };
    let Some((major, library)) = found else {
        fail("Embree was not found: install the package libembree-dev, or set EMBREE_DIR to its prefix");
    };
    let define = major.to_string();

    let bindings = builder("ffi/embree.h", &library)
        .clang_arg(format!("-DTWOPASS_EMBREE={define}"))
        .allowlist_function("twopass_.*")
        .allowlist_function("rtc(New|Release)(Device|Scene|Geometry)")
        .allowlist_function("rtc(GetDeviceProperty|GetDeviceError|SetDeviceErrorFunction)")
        .allowlist_function(
            "rtcSet(SceneFlags|SceneBuildQuality|GeometryBuildQuality|GeometryMask|NewGeometryBuffer)",
        )
        .allowlist_function("rtc(CommitGeometry|AttachGeometryByID|CommitScene)")
        .allowlist_type("RTCRay|RTCRay16|RTCRayHit|RTCRayHit4|RTCRayHit8|RTCRayHit16")
        .allowlist_type("RTC(Error|Format|BufferType|GeometryType|BuildQuality|SceneFlags|DeviceProperty)")
        .allowlist_var("RTC_VERSION");
    generate(bindings, "embree.rs");

    let mut shim = cc::Build::new();
    shim.file("ffi/embree_shim.c")
        .includes(&library.include)
        .define("TWOPASS_EMBREE", define.as_str())
        .warnings(true);
    compile(&shim, "twopass_embree_shim");
    library.link(&[&format!("embree{major}")]);
}

fn oiio() {
    let header = "OpenImageIO/imageio.h";
    let found = match prefix("OIIO_DIR") {
        Some(dir) => {
            let library = Library::under(&dir);
            if !library.has(header) {
                fail(&format!("OIIO_DIR={} holds no include/{header}", dir.display()));
            }
            Some(library)
        }
        None => Library::installed("OpenImageIO", header),
    };
    let Some(library) = found else {
        fail(
            "OpenImageIO was not found: install the package libopenimageio-dev, or set OIIO_DIR to its prefix",
        );
    };

    println!("cargo::rustc-env=TWOPASS_OIIO_BUILT={}", oiio_version(&library));

    // Bound as a library that the program loads when the first image is written or read: the 250 libraries that
    // OpenImageIO brings take a third of a second to load, more than many a command does otherwise.
    let bindings = builder("ffi/oiio_shim.h", &library)
        .allowlist_function("twopass_.*")
        .allowlist_type("Twopass.*")
        .dynamic_library_name("Shim")
        .dynamic_link_require_all(true);
    generate(bindings, "oiio.rs");

    let mut shim = cc::Build::new();
    // OpenImageIO's own headers warn.
    shim.cpp(true)
        .std("c++17")
        .file("ffi/oiio_shim.cpp")
        .includes(&library.include)
        .warnings(false)
        .pic(true);
    let name = "twopass_oiio_shim";
    let objects = shim.try_compile_intermediates().unwrap_or_else(|error| not_compiled(name, &error));
    let file = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join("twopass_oiio_shim.so");
    let mut linker = shim.get_compiler().to_command();
    linker.arg("-shared").arg("-o").arg(&file).args(objects);
    for dir in &library.link {
        linker.arg("-L").arg(dir).arg(format!("-Wl,-rpath,{}", dir.display()));
    }
    match linker.args(["-lOpenImageIO", "-lOpenImageIO_Util"]).output() {
        Ok(output) if output.status.success() => {}
        Ok(output) => not_compiled(name, &String::from_utf8_lossy(&output.stderr)),
        Err(error) => not_compiled(name, &error),
    }
}

/// The version that the headers of OpenImageIO state.
fn oiio_version(library: &Library) -> String {
    let usual = PathBuf::from("/usr/include");
    let header = library.include.iter().chain([&usual]).map(|d| d.join("OpenImageIO/oiioversion.h"));
    let text = header.filter_map(|path| std::fs::read_to_string(path).ok()).next().unwrap_or_default();
    let number = |part: &str| {
        let define = format!("#define OIIO_VERSION_{part} ");
        text.lines().find_map(|l| l.strip_prefix(&define)).unwrap_or("?").trim().to_string()
    };
    ["MAJOR", "MINOR", "PATCH"].map(number).join(".")
}

fn compile(shim: &cc::Build, name: &str) {
    shim.try_compile(name).unwrap_or_else(|error| not_compiled(name, &error));
}

fn not_compiled(name: &str, error: &dyn std::fmt::Display) -> ! {
    fail(&format!("{name} did not compile; the package g++ has the compilers it needs ({error})"))
}

fn builder(header: &str, library: &Library) -> bindgen::Builder {
    let Ok(floor) = bindgen::RustTarget::stable(85, 0) else { fail("bindgen does not know Rust 1.85") };
    bindgen::Builder::default()
        .header(header)
        .clang_args(library.include.iter().map(|dir| format!("-I{}", dir.display())))
        .rust_target(floor)
        .rust_edition(bindgen::RustEdition::Edition2024)
        .derive_default(true)
        .prepend_enum_name(false)
        .layout_tests(true)
        .generate_comments(false)
        .formatter(bindgen::Formatter::None)
        // Rebuilds when an installed header changes, as after an upgrade of the library.
        .parse_callbacks(Box::new(bindgen::CargoCallbacks::new()))
}

fn generate(builder: bindgen::Builder, file: &str) {
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join(file);
    match builder.generate() {
        Ok(bindings) => {
            if let Err(error) = bindings.write_to_file(&out) {
                fail(&format!("{}: {error}", out.display()));
            }
        }
        Err(error) => fail(&format!("headers could not be bound ({error})")),
    }
}
