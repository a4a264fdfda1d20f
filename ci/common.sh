# What the scripts of this directory share. Sourced, not run.

say() { printf '%s: %s\n' "$(basename "$0")" "$*" >&2; }

fail() {
    say "$*"
    exit 1
}

# Mirrors and proxies drop connections: what asks the network is tried three times.
retry() {
    local try
    for try in 1 2 3; do
        "$@" && return 0
        [ "$try" = 3 ] || { say "try $try of 3 failed: $*"; sleep $((5 * try)); }
    done
    return 1
}

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    elif command -v sudo >/dev/null; then
        sudo "$@"
    else
        fail "this needs root and there is no sudo: $*"
    fi
}

# Installs Debian packages and says so.
apt_install() {
    say "installing $*"
    local quiet=(-qq -o=Dpkg::Use-Pty=0 -o=Acquire::Retries=3)
    # Without lists, and with lists that name versions gone from the mirror, only an update helps.
    retry as_root apt-get "${quiet[@]}" update || fail "apt-get update failed"
    # </dev/null: no package may wait for an answer that nobody gives.
    retry as_root env DEBIAN_FRONTEND=noninteractive \
        apt-get "${quiet[@]}" install --yes --no-install-recommends "$@" </dev/null >/dev/null ||
        fail "could not install $*"
}
