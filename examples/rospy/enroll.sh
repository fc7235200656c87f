#!/usr/bin/env bash
# What the programs of this folder need. Then, in another shell: rossec master
. "$(dirname "$0")/../begin.sh" /master /robot /viewer

may /robot --publish /chatter --publish /camera/image --provide /lamp
may /viewer --subscribe /chatter --call /lamp \
    --param-get "/viewer/**" --param-set "/viewer/**"
may /viewer --subscribe /camera/image --type sensor_msgs/Image --clear header.frame_id \
    --rate 5 --when 'msg.height < 1000'
