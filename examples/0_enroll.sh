#!/usr/bin/env bash
# Three nodes of the trust domain "home", and what two of them may do.
. "$(dirname "$0")/begin.sh" /master /talker /listener

may /talker --publish /chatter --publish /robot/pose --provide /talker/mute --param-get /talker
may /listener --subscribe /chatter --call /talker/mute --param-set /talker/rate
echo "now start the master in another shell: rossec master"
