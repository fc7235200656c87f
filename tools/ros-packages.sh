#!/usr/bin/env bash
# Installs the ROS 1 packages the tests run against (Debian and Ubuntu ship them), and the browser
# that opens the console's pages, the shells that complete commands and what reads manual pages
# (Debian ships them). Without them the tests that need them are
# reported as not run; with CI set they fail.
set -euo pipefail
ros=(
    python3-venv python3-rospy python3-rosmaster python3-rostopic python3-rosnode
    python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-nav-msgs
    python3-diagnostic-msgs python3-stereo-msgs python3-shape-msgs python3-trajectory-msgs
    python3-visualization-msgs python3-actionlib-msgs python3-actionlib python3-tf2-msgs
    python3-std-srvs python3-rosgraph-msgs python3-rosbag python3-rosservice python3-rosparam
    python3-roslaunch python3-tf2-ros python3-dynamic-reconfigure rosout topic-tools libroscpp-dev libstd-msgs-dev g++ pkg-config
    libnodeletlib-tools libnodeletlib-dev tf2-tools rviz xvfb
    tcpdump iproute2 nftables openssl stunnel4 softhsm2 fonts-dejavu-core librsvg2-bin
)
shells=(zsh fish mandoc groff-base man-db)
browser=(chromium libnss3-tools fonts-inter fonts-dejavu-core)

not_run() { echo "rossec: the $1 tests will be reported as not run: $2" >&2; }
install() { "${as_root[@]}" apt-get install -qq -y --no-install-recommends "$@" >/dev/null; }

ensure() {  # KIND PACKAGE...
    local kind=$1 package missing=() as_root=()
    shift
    for package; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} -eq 0 ] && return
    command -v apt-get >/dev/null || { not_run "$kind" "no apt-get on this system"; return; }
    if [ "$(id -u)" != 0 ]; then
        command -v sudo >/dev/null && sudo -n true 2>/dev/null ||
            { not_run "$kind" "installing ${missing[*]} needs root or sudo"; return; }
        as_root=(sudo -n)
    fi
    echo "rossec: installing ${missing[*]} with apt-get"
    install "${missing[@]}" 2>/dev/null || { "${as_root[@]}" apt-get update -qq && install "${missing[@]}"; } ||
        not_run "$kind" "apt-get could not install them"
}

export DEBIAN_FRONTEND=noninteractive
ensure ROS "${ros[@]}"
ensure browser "${browser[@]}"
ensure shell "${shells[@]}"
