#!/usr/bin/env bash
# Installs the ROS 1 packages the tests run against (Debian and Ubuntu ship them). Without them the
# ROS tests are reported as not run; with CI set they fail.
set -euo pipefail
packages=(
    python3-venv python3-rospy python3-rosmaster python3-rostopic python3-rosnode
    python3-std-msgs python3-geometry-msgs python3-sensor-msgs python3-nav-msgs
    python3-diagnostic-msgs python3-stereo-msgs python3-shape-msgs python3-trajectory-msgs
    python3-visualization-msgs python3-actionlib-msgs python3-actionlib python3-tf2-msgs
    python3-std-srvs python3-rosgraph-msgs python3-rosbag python3-rosservice python3-rosparam
    python3-roslaunch python3-tf2-ros python3-dynamic-reconfigure rosout topic-tools libroscpp-dev libstd-msgs-dev g++ pkg-config
    libnodeletlib-tools libnodeletlib-dev tf2-tools rviz xvfb
    tcpdump iproute2 openssl stunnel4 softhsm2 fonts-dejavu-core librsvg2-bin
)

missing=()
for package in "${packages[@]}"; do
    dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
[ ${#missing[@]} -eq 0 ] && exit 0

not_run() {
    echo "rossec: the ROS tests will be reported as not run: $1" >&2
    exit 0
}
command -v apt-get >/dev/null || not_run "no apt-get on this system"
if [ "$(id -u)" = 0 ]; then as_root=()
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root=(sudo -n)
else not_run "installing ${missing[*]} needs root or sudo"; fi

echo "rossec: installing ${missing[*]} with apt-get"
export DEBIAN_FRONTEND=noninteractive
install() { "${as_root[@]}" apt-get install -qq -y --no-install-recommends "${missing[@]}" >/dev/null; }
install 2>/dev/null || { "${as_root[@]}" apt-get update -qq && install; } || not_run "apt-get could not install them"
