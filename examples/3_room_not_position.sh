#!/usr/bin/env bash
# The listener may know where the robot is, to two metres, and only by day: the talker's node rounds
# the position and clears the frame before a byte leaves it.
set -euo pipefail
rossec grant sign /listener --subscribe /robot/pose \
    --type geometry_msgs/PoseStamped \
    --round pose.position=2.0 --clear pose.orientation --clear header.frame_id \
    --when 'now.getHours("Europe/Zurich") >= 0 && msg.header.frame_id == "map"' \
    --for 1d --passphrase-file "$ROSSEC_HOME/passphrase"

rossec topic pub /robot/pose geometry_msgs/PoseStamped --as /talker --rate 20 \
    '{header: {frame_id: map}, pose: {position: {x: 3.7, y: -0.4}}}' &
trap 'kill $!' EXIT
rossec topic echo /robot/pose geometry_msgs/PoseStamped --as /listener -n 1
