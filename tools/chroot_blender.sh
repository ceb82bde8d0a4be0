#!/usr/bin/env bash
# A real, windowed Blender (5.2 LTS or later) in a Debian chroot, for tests/app.
#
#   tools/chroot_blender.sh ensure          build it where it is missing (root; 3 minutes, 2 GB)
#   tools/chroot_blender.sh path            print where it lies; exit 1 where it is not built
#   tools/chroot_blender.sh run CMD...      run CMD inside, without network, the checkout mounted read-only on /hnf,
#                                           $HNF_CHROOT_SHARE (if set) read-write on /share, and the files and
#                                           folders of $HNF_CHROOT_LENT (by colons) read-only, each where it lies here
#   tools/chroot_blender.sh remove          delete it
#
# $HNF_CHROOT names the folder (default build/chroot); $HNF_CHROOT_SUITES the Debian suites to try in turn.
# Every mount is made in a private mount namespace, so nothing is left mounted when a run ends, however it ends,
# and deleting the folder can never reach the host's /dev.
# Exit codes: 0 done, 1 failed, 3 cannot be had here (not root, no debootstrap, no network): skip, do not fail.
set -euo pipefail

repo=$(cd "$(dirname "$0")/.." && pwd)
root=${HNF_CHROOT:-$repo/build/chroot}
suites=${HNF_CHROOT_SUITES:-sid trixie} # sid: Blender 5.2 LTS; trixie: 4.3.2, where sid cannot be installed
# The archive that this Debian installs from; elsewhere empty, and debootstrap takes its own default.
system_archive() { apt-get indextargets --format '$(ORIGIN) $(SITE)' 2>/dev/null | awk '$1 == "Debian" {print $2; exit}'; }
mirror=${HNF_DEBIAN_MIRROR:-$(system_archive || true)}
# Debian's blender misses cattr, requests and numpy among its dependencies: without them its extension system does not
# register and add-ons find no numpy.
packages="blender python3-cattr python3-requests python3-numpy python3-zstandard xvfb xauth xdotool scrot imagemagick libgl1-mesa-dri libegl1 libegl-mesa0 libglx-mesa0 fonts-dejavu-core"
clean_env=(env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive)

unavailable() { echo "chroot: $1" >&2; exit 3; }

require_root() {
    [ "$(id -u)" = 0 ] || unavailable "needs root"
    unshare --mount true 2>/dev/null || unavailable "this machine allows no mount namespaces"
}

# Everything below runs inside `unshare --mount --pid --fork`: $1 is the chroot, the rest the command.
enter() {
    local chroot=$1
    shift
    HNF_INNER_ROOT=$chroot HNF_INNER_REPO=$repo HNF_INNER_SHARE=${HNF_CHROOT_SHARE:-} \
        HNF_INNER_LENT=${HNF_CHROOT_LENT:-} unshare --mount --pid --fork --kill-child --propagation private ${isolation:-} bash -euc '
        r=$HNF_INNER_ROOT
        mount -t proc proc "$r/proc"
        mount -t sysfs -o ro sysfs "$r/sys"
        mount -t tmpfs -o mode=755 tmpfs "$r/dev"
        for node in null zero full random urandom tty; do
            : > "$r/dev/$node"
            mount --bind "/dev/$node" "$r/dev/$node"
        done
        mkdir -p "$r/dev/pts" "$r/dev/shm"
        mount -t devpts -o newinstance,ptmxmode=0666 devpts "$r/dev/pts"
        ln -s pts/ptmx "$r/dev/ptmx"
        ln -s /proc/self/fd "$r/dev/fd"
        mount -t tmpfs -o mode=1777 tmpfs "$r/dev/shm"
        mount -t tmpfs -o mode=1777 tmpfs "$r/tmp"
        mkdir -p "$r/hnf" "$r/share"
        mount --bind "$HNF_INNER_REPO" "$r/hnf"
        mount -o remount,bind,ro "$r/hnf"
        if [ -n "$HNF_INNER_SHARE" ]; then mount --bind "$HNF_INNER_SHARE" "$r/share"; fi
        IFS=:
        for lent in $HNF_INNER_LENT; do
            if [ -d "$lent" ]; then mkdir -p "$r$lent"; else mkdir -p "$r${lent%/*}"; : >>"$r$lent"; fi
            mount --bind "$lent" "$r$lent"
            mount -o remount,bind,ro "$r$lent"
        done
        unset IFS
        # No exec: as process 1 of the namespace, coreutils 9.10 `timeout` takes its child for an orphan and fails.
        status=0
        chroot "$r" "$@" || status=$?
        exit $status' enter "$@"
}

build() {
    local suite=$1 work=$root/$1.partial
    rm -rf --one-file-system "$work"
    mkdir -p "$work"
    # unshare: debootstrap mounts proc and sys itself; they go away with the namespace.
    timeout 900 unshare --mount --propagation private \
        debootstrap --variant=minbase "$suite" "$work" ${mirror:+"$mirror"} >"$root/$suite.log" 2>&1 || return 1
    local file
    for file in /etc/resolv.conf /etc/hosts /etc/ssl/certs/ca-certificates.crt; do
        [ -e "$file" ] && install -D -m 644 "$(readlink -f "$file")" "$work$file"
    done
    printf '#!/bin/sh\nexit 101\n' >"$work/usr/sbin/policy-rc.d"   # no service may start in a chroot
    chmod 755 "$work/usr/sbin/policy-rc.d"
    ln -sf /proc/self/mounts "$work/etc/mtab"   # Blender lists mounted file systems at start
    # A mirror that lags serves a release file past its date; its signature is checked all the same.
    printf 'Acquire::Check-Valid-Until "false";\nAcquire::Retries "3";\n' >"$work/etc/apt/apt.conf.d/90hnf"
    # A crash of this machine costs nothing: it would be built anew.
    printf 'force-unsafe-io\n' >"$work/etc/dpkg/dpkg.cfg.d/hnf"
    # shellcheck disable=SC2086  # the package list is meant to split
    enter "$work" "${clean_env[@]}" timeout 1200 sh -ec \
        'apt-get -q update; apt-get -q install -y --no-install-recommends "$@"; apt-get -q clean; rm -rf /var/lib/apt/lists/*' \
        install $packages >>"$root/$suite.log" 2>&1 </dev/null || return 1
    enter "$work" "${clean_env[@]}" timeout 60 blender --version >"$work/hnf-blender-version" 2>>"$root/$suite.log" || return 1
    echo "$packages" >"$work/hnf-packages" || return 1
    rm -rf --one-file-system "$root/$suite"
    mv "$work" "$root/$suite"
}

find_built() {
    local suite
    for suite in $suites; do
        if [ -s "$root/$suite/hnf-blender-version" ] && [ "$(cat "$root/$suite/hnf-packages" 2>/dev/null)" = "$packages" ]
        then echo "$root/$suite"; return 0; fi
    done
    return 1
}

verb=${1:-}
shift || true
case "$verb" in
    ensure)
        if built=$(find_built); then echo "$built: $(head -n 1 "$built/hnf-blender-version")"; exit 0; fi
        require_root
        command -v debootstrap >/dev/null || unavailable "debootstrap is not installed (apt-get install debootstrap)"
        mkdir -p "$root"
        exec 9>"$root/lock"
        flock 9
        if built=$(find_built); then echo "$built: $(head -n 1 "$built/hnf-blender-version")"; exit 0; fi
        for suite in $suites; do
            if build "$suite"; then echo "$root/$suite: $(head -n 1 "$root/$suite/hnf-blender-version")"; exit 0; fi
            echo "chroot: Debian $suite failed; the end of $root/$suite.log:" >&2
            tail -n 5 "$root/$suite.log" >&2 || true
        done
        unavailable "no Debian suite of '$suites' could be installed${mirror:+ from $mirror}"
        ;;
    path) find_built ;;
    run)
        require_root
        built=$(find_built) || unavailable "not built yet: run tools/chroot_blender.sh ensure"
        isolation=--net   # no network: nothing here needs it, and displays cannot clash with the host's
        enter "$built" "${clean_env[@]}" "$@"
        ;;
    remove)
        rm -rf --one-file-system "$root"
        ;;
    *)
        sed -n '2,15p' "$0" >&2
        exit 2
        ;;
esac
