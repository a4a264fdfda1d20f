#!/usr/bin/env bash
# The part of debian13.sh that needs root: makes the Debian 13 root where there is none, copies the
# checkout into it and runs the suite there.
set -euo pipefail
. "$(dirname "$0")/common.sh"

checkout=$1
cache=$2
mounts=$3 # "private" where this runs in a mount namespace of its own, "none" where it must not mount
root=$cache/debian13
home=/var/cache/twopass # inside the root: crates and build results

# A URL of Debian's own archive among apt's sources; none on other distributions.
mirror() {
    find /etc/apt -name '*.list' -o -name '*.sources' | xargs --no-run-if-empty cat |
        awk '/^[ \t]*#/ { next }
            { for (i = 1; i <= NF; i++) if (!url && $i ~ /^https?:.*\/debian\/?$/) url = $i }
            END { print url }'
}

# Nothing is mounted below the root by now, except by hand; what is, must not be emptied with it.
remove() {
    local point
    awk -v below="$1/" 'index($5, below) == 1 { print $5 }' /proc/self/mountinfo | sort --reverse |
        while read -r point; do umount --lazy "$point" || fail "still mounted: $point"; done
    rm -rf --one-file-system "$1"
}

inside() {
    local root=$1
    shift
    chroot "$root" /usr/bin/env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 TERM=dumb \
        "CI=${CI:-}" "http_proxy=${http_proxy:-}" "https_proxy=${https_proxy:-}" DEBIAN_FRONTEND=noninteractive \
        "CARGO_HOME=$home/cargo" "CARGO_TARGET_DIR=$home/target" CARGO_NET_OFFLINE=true \
        "CARGO_INCREMENTAL=${CARGO_INCREMENTAL:-1}" \
        "CARGO_PROFILE_TEST_DEBUG=${CARGO_PROFILE_TEST_DEBUG:-line-tables-only}" "$@" </dev/null
}

# What the host knows about reaching the network.
share_network() {
    cat /etc/resolv.conf >"$1/etc/resolv.conf" 2>/dev/null || true
    # Where the mirror is https: a bare root trusts no certificate.
    mkdir -p "$1/etc/ssl/certs"
    cp /etc/ssl/certs/ca-certificates.crt "$1/etc/ssl/certs/" 2>/dev/null || true
    apt-config dump | grep -E '^Acquire::(https?|Check-[A-Za-z-]+|Retries)(::[A-Za-z0-9.:-]+)? "[^"]' \
        >"$1/etc/apt/apt.conf.d/99host" || true
}

# Brings a directory up to date with a list of files on standard input, each ended by a null byte.
# Contents decide, not times: the build results are shared by all checkouts, and cargo, which goes by
# times, must see a file as new exactly when it differs from what it built last.
mirror_files() {
    local from=$1 to=$2 file list
    list=$(mktemp)
    mkdir -p "$to"
    while IFS= read -r -d '' file; do
        [ -f "$from/$file" ] || continue # deleted, and git not told yet
        printf '%s\0' "$file" >>"$list"
        cmp --quiet "$from/$file" "$to/$file" || (cd "$from" && cp --parents --preserve=mode "$file" "$to")
    done
    (cd "$to" && find . -type f -printf '%P\0') | sort --zero-terminated |
        comm --zero-terminated -23 - <(sort --zero-terminated "$list") |
        (cd "$to" && xargs --null --no-run-if-empty rm)
    rm "$list"
}

copy_checkout() {
    local root=$1
    if [ -e "$checkout/.git" ]; then
        # safe.directory: under sudo the checkout belongs to another user.
        git -c "safe.directory=$checkout" -C "$checkout" ls-files --cached --others --exclude-standard -z
    else
        (cd "$checkout" && find . \( -path ./target -o -path ./out \) -prune -o -type f -printf '%P\0')
    fi | mirror_files "$checkout" "$root/srv/twopass"
    # Reference data that may lie beside the checkout; tests say so where it does not.
    if [ -d "$checkout/../shared" ]; then
        (cd "$checkout/../shared/" && find . -type f -printf '%P\0') | mirror_files "$checkout/../shared" "$root/srv/shared"
    else
        rm -rf "$root/srv/shared"
    fi
}

copy_crates() {
    local root=$1
    cmp --quiet "$cache/vendor.lock" "$root$home/vendor.lock" && return
    rm -rf "$root$home/vendor" "$root$home/vendor.lock"
    mkdir -p "$root$home/cargo"
    cp -r "$cache/vendor" "$root$home/vendor"
    cat >"$root$home/cargo/config.toml" <<TOML
[source.crates-io]
replace-with = "vendored"
[source.vendored]
directory = "$home/vendor"
TOML
    cp "$cache/vendor.lock" "$root$home/vendor.lock"
}

mount_proc() {
    [ "$mounts" = private ] && mount -t proc proc "$1/proc" 2>/dev/null ||
        say "mounts are not permitted here: no /proc inside"
}

if [ ! -d "$root" ]; then
    building=$root.building
    remove "$building"
    if [ -z "${http_proxy:-}" ]; then
        # debootstrap does not read apt's configuration.
        eval "$(apt-config shell http_proxy Acquire::http::Proxy)"
        export http_proxy
    fi
    source=$(mirror)
    say "making a Debian 13 root from ${source:-the default mirror}; this takes a few minutes, once"
    bootstrap() {
        remove "$building"
        debootstrap --variant=minbase trixie "$building" ${source:+"$source"} >"$cache/debootstrap.log" 2>&1 ||
            { tail -n 5 "$cache/debootstrap.log" >&2; return 1; }
    }
    retry bootstrap || fail "debootstrap failed, see $cache/debootstrap.log"
    share_network "$building"
    mount_proc "$building"
    copy_checkout "$building"
    # Only cargo is given by hand. All else comes from the project's own set-up, tried here on a bare
    # system.
    inside "$building" bash -c '. /srv/twopass/ci/common.sh && apt_install cargo'
    inside "$building" bash /srv/twopass/ci/setup.sh
    inside "$building" apt-get clean
    umount "$building/proc" 2>/dev/null || true
    mv "$building" "$root"
fi

share_network "$root"
copy_checkout "$root"
copy_crates "$root"
mount_proc "$root"
say "$(inside "$root" cargo --version), $(inside "$root" dpkg-query -W -f '${Package} ${Version}  ' libembree-dev libopenimageio-dev)"
inside "$root" make --no-print-directory -C /srv/twopass test
