#!/usr/bin/env bash
# Installs the Debian packages that a build needs and that are missing. Where none is missing, apt is
# not asked at all: the script then works offline, without root, and in no time.
set -euo pipefail
. "$(dirname "$0")/common.sh"

installed() {
    [ "$(dpkg-query --show --showformat='${db:Status-Status}' "$1" 2>/dev/null)" = installed ]
}

missing=()
# Programs are looked for by name: who has them from elsewhere needs no package.
need_program() { command -v "$1" >/dev/null || missing+=("$2"); }
# Libraries are looked for as packages, unless a variable that build.rs reads says where another is.
need_library() { [ -n "${!1:-}" ] || installed "$2" || missing+=("$2"); }

need_program make make
need_program c++ g++
need_program pkg-config pkg-config
if command -v dpkg-query >/dev/null; then
    need_library EMBREE_DIR libembree-dev
    need_library OIIO_DIR libopenimageio-dev
    need_library LIBCLANG_PATH libclang-dev
fi

if [ ${#missing[@]} -gt 0 ]; then
    command -v apt-get >/dev/null || fail "install what these Debian packages hold: ${missing[*]}"
    apt_install "${missing[@]}"
fi

# Not installed from here: which Rust a machine has is its owner's choice.
version=$(cargo --version 2>/dev/null | cut -d ' ' -f 2) || true
if ! printf '1.85\n%s\n' "${version:-0}" | sort --check=quiet --version-sort; then
    fail "cargo 1.85 or newer is needed, found ${version:-none}: on Debian 13 apt-get install cargo, elsewhere see https://rustup.rs"
fi
