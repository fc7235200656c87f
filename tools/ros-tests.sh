#!/usr/bin/env bash
# Runs ROS's own rospy tests (test_rospy of ros_comm) in plain ROS, behind a sidecar, and in-process.
# The sources come from Debian's source package at run time; nothing of them is part of the project.
# Usage: tools/ros-tests.sh [DIRECTORY [ros_tests.py's arguments]]
set -euo pipefail
cd "$(dirname "$0")/.."
directory=${1:-$(mktemp -d)}
shift || true
mkdir -p "$directory"
work=$(cd "$directory" && pwd)

fetch() {  # from where this host has its packages, the sources of them included
    local parts=$work/apt/parts
    mkdir -p "$work/apt/lists/partial" "$work/apt/cache/archives/partial" "$parts"
    find /etc/apt/sources.list.d -name '*.sources' -exec cp -t "$parts" {} +
    find "$parts" -name '*.sources' -exec sed -i 's/^Types:.*/Types: deb deb-src/' {} +
    find /etc/apt -maxdepth 2 -name '*.list' -exec sed -n 's/^deb \(.*\)/deb \1\ndeb-src \1/p' {} + \
        >"$parts/host.list"
    cat >"$work/apt/apt.conf" <<END
Dir::Etc::sourcelist "/dev/null";
Dir::Etc::sourceparts "$parts";
Dir::State::lists "$work/apt/lists";
Dir::Cache "$work/apt/cache";
END
    export APT_CONFIG=$work/apt/apt.conf
    (cd "$work/apt" && apt-get -qq update && apt-get -qq --download-only source ros-ros-comm \
        && apt-get -qq download python3-rostest python3-psutil ros-std-msgs)
    mkdir -p "$work/ros_comm"
    for package in "$work"/apt/*.deb; do dpkg -x "$package" "$work/debian"; done
    tar -C "$work/ros_comm" --strip-components=1 -xf "$work"/apt/ros-ros-comm_*.orig.tar.*
}

generate() {  # Python classes of the messages and services of a package
    local package=$1 at=$work/ros_comm/test/$1 into=$work/gen.new/$1 kind
    local -a include=(-Istd_msgs:$work/debian/usr/share/std_msgs/msg)
    for kind in test_rospy test_rosmaster; do include+=("-I$kind:$work/ros_comm/test/$kind/msg"); done
    for kind in msg srv; do
        mkdir -p "$into/$kind"
        touch "$into/__init__.py"
        (cd "$at/$kind" && for file in *."$kind"; do
            /usr/bin/python3 "/usr/lib/genpy/gen${kind}_py.py" -p "$package" \
                "${include[@]}" -o "$into/$kind" "$at/$kind/$file"
        done)
        /usr/bin/python3 "/usr/lib/genpy/gen${kind}_py.py" --initpy -p "$package" \
            -o "$into/$kind"
    done
    mkdir -p "$work/gen"
    mv "$into" "$work/gen/"
}

[ -d "$work/ros_comm" ] || fetch
for package in test_rosmaster test_rospy; do
    [ -d "$work/gen/$package" ] || generate "$package"
done
exec env PYTHONPATH=. .venv/bin/python tools/ros_tests.py "$work" "$@"
