#!/bin/sh
# Install the packages of a list that are missing, where this user may. Never fails: what is lost without them is
# said in one line.
#
#   sh docker/install-system-packages.sh docker/system-packages.txt "open3d will not load"
set -u
list="$1" lost="$2"
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
    echo "datagen: not root, so these system packages stay missing:$missing; without them $lost" >&2
    exit 0
fi
export DEBIAN_FRONTEND=noninteractive
# shellcheck disable=SC2086 # word splitting is meant: several packages, or no prefix
$as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null ||
    echo "datagen: could not install$missing; without them $lost" >&2
exit 0
