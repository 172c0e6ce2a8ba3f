#!/bin/sh
# Install the packages of system-packages.txt that are missing, where this user may. Never fails: without them only
# open3d is out of reach, and what needs it says so in one line.
set -u
list="$(dirname "$0")/system-packages.txt"
command -v apt-get >/dev/null 2>&1 || exit 0
missing=""
while read -r package; do
    [ -n "$package" ] || continue
    dpkg -s "$package" >/dev/null 2>&1 || missing="$missing $package"
done <"$list"
[ -n "$missing" ] || exit 0
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo -n"
else
    echo "datagen: not root, so these system packages stay missing and open3d will not load:$missing" >&2
    exit 0
fi
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086 # word splitting is meant: several packages, or no prefix
$as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null ||
    echo "datagen: could not install$missing; open3d will not load without them" >&2
exit 0
