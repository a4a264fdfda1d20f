#!/usr/bin/env bash
# Runs the test suite in a Debian 13 root: built by Debian's own cargo 1.85, against its Embree 4 and
# OpenImageIO 2.5. The root is kept outside the checkout, for the next run and for other checkouts.
set -euo pipefail
. "$(dirname "$0")/common.sh"

checkout=$(cd "$(dirname "$0")/.." && pwd)
cache=${XDG_CACHE_HOME:-$HOME/.cache}/twopass
mkdir -p "$cache"

# One run at a time: all use the same root.
exec 9>"$cache/debian13.lock"
flock --nonblock 9 || { say "waiting for another run"; flock 9; }

command -v debootstrap >/dev/null || apt_install debootstrap debian-archive-keyring

# The crates are fetched out here, where the network, its proxy and its certificates are known to
# work, and vendored: that does not depend on the layout of cargo's home, which differs by version.
lock=$(sha256sum <"$checkout/Cargo.lock")
if [ "$(cat "$cache/vendor.lock" 2>/dev/null)" != "$lock" ]; then
    rm -rf "$cache/vendor" "$cache/vendor.lock"
    retry cargo vendor --quiet --locked --versioned-dirs --manifest-path "$checkout/Cargo.toml" "$cache/vendor" >/dev/null ||
        fail "cargo vendor failed"
    printf '%s\n' "$lock" >"$cache/vendor.lock"
fi

# Mounts in a namespace of their own cannot outlive the run, however it ends. Where that is not
# permitted, as in most containers, the suite runs without /proc, which it does not need.
namespace=()
mounts=none
if as_root unshare --mount --propagation private true 2>/dev/null; then
    namespace=(unshare --mount --propagation private)
    mounts=private
fi
as_root env "CI=${CI:-}" "http_proxy=${http_proxy:-}" "https_proxy=${https_proxy:-}" \
    "${namespace[@]}" bash "$checkout/ci/debian13_root.sh" "$checkout" "$cache" "$mounts"
