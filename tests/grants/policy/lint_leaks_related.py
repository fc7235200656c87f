"""Leaks by what is related to something hidden: another topic, a service, a right, a frame.

As `lint_leaks`, whose rules and treatments these are made of.
"""

from tests.grants.policy.lint_leaks import (
    CELLS,
    COARSE,
    HASHED,
    LIMIT,
    REST,
    ROOMS,
    SECOND,
    SQUARES,
    TIMES,
    Leak,
    also,
    filtered,
    pose,
)

BATTERY = (("/battery", "sensor_msgs/BatteryState"),)
STILL = "twist: {clear: true}, pose: {clear: true}"
AIR = "header: {clear: true}, variance: {clear: true}"
NO_NAMES = "status[*].name: {clear: true}, status[*].hardware_id: {clear: true}"
KEPT = "id: a, who: /x, allow: {subscribe: [/words]}, filter: {use: presence-only}"
RELATED = (
    *(
        Leak(f"a position by {kind}", "exact-relative", (COARSE, also("/other")), types=(("/other", kind),))
        for kind in (
            "sensor_msgs/BatteryState",
            "actionlib_msgs/GoalStatusArray",
            "actionlib_msgs/GoalStatus",
            "sensor_msgs/MagneticField",
            "geometry_msgs/QuaternionStamped",
            "sensor_msgs/Imu",
            "sensor_msgs/FluidPressure",
            "sensor_msgs/Temperature",
            "sensor_msgs/Illuminance",
            "sensor_msgs/RelativeHumidity",
            "visualization_msgs/MarkerArray",
            "sensor_msgs/Joy",
            "geometry_msgs/WrenchStamped",
            "tf2_msgs/TFMessage",
            "sensor_msgs/Range",
            "trajectory_msgs/JointTrajectory",
            "sensor_msgs/PointCloud",
        )
    ),
    *(
        Leak(f"a movement by {topic}", "exact-relative", (filtered("/odom", STILL, SECOND), also(topic)))
        for topic in ("/cmd_vel", "/scan", "/camera2")
    ),
    *(
        Leak(
            f"how fast it is by {topic}",
            "exact-relative",
            (filtered("/cmd_vel", "linear: {clear: true}, angular: {clear: true}", SECOND), also(topic)),
        )
        for topic in ("/odom", "/pose", "/joints", "/scan", "/camera", "/fix")
    ),
    *(
        Leak(
            f"how fast it is by {kind}",
            "exact-relative",
            (filtered("/cmd_vel", "linear: {clear: true}, angular: {clear: true}", SECOND), also("/other")),
            types=(("/other", kind),),
        )
        for kind in ("sensor_msgs/BatteryState", "sensor_msgs/Imu", "geometry_msgs/WrenchStamped")
    ),
    Leak(
        "sound by another microphone",
        "exact-relative",
        (filtered("/mic", "data: {clear: true}", SECOND), also("/mic2")),
        types=(("/mic", "audio_common_msgs/AudioData"), ("/mic2", "audio_common_msgs/AudioDataStamped")),
    ),
    Leak(
        "a temperature by another",
        "exact-relative",
        (filtered("/air", f"{AIR}, temperature: {{round: {{step: 2, hysteresis: 1}}}}"), also("/floor")),
        "vocabulary: {/floor: {data: temperature}}\n",
        types=(("/air", "sensor_msgs/Temperature"), ("/floor", "std_msgs/Float32")),
    ),
    Leak(
        "a humidity by another",
        "exact-relative",
        (filtered("/air", f"{AIR}, relative_humidity: {{clear: true}}", SECOND), also("/bath")),
        types=(("/air", "sensor_msgs/RelativeHumidity"), ("/bath", "sensor_msgs/RelativeHumidity")),
    ),
    Leak(
        "light by a picture",
        "exact-relative",
        (filtered("/lux", f"{AIR}, illuminance: {{clear: true}}", SECOND), also("/camera")),
        types=(("/lux", "sensor_msgs/Illuminance"),),
    ),
    Leak(
        "a battery by another",
        "exact-relative",
        ("id: a, who: /x, allow: {subscribe: [/battery]}, see: {home: rough}", also("/battery2")),
        types=(*BATTERY, ("/battery2", "sensor_msgs/BatteryState")),
    ),
    Leak(
        "a map by a scan",
        "exact-relative",
        (filtered("/map", "data: {clear: true}, info: {clear: true}", SECOND), also("/scan")),
    ),
    Leak(
        "a map by another",
        "exact-relative",
        (filtered("/map", "data: {clear: true}, info: {clear: true}", SECOND), also("/map2")),
        types=(("/map2", "nav_msgs/OccupancyGrid"),),
    ),
    *(
        Leak(
            f"a picture by {kind}",
            "exact-relative",
            (filtered("/camera", f"data: {SQUARES}", SECOND), also("/depth")),
            types=(("/depth", kind),),
        )
        for kind in (
            "sensor_msgs/Image",
            "sensor_msgs/PointCloud2",
            "sensor_msgs/PointCloud",
            "stereo_msgs/DisparityImage",
        )
    ),
    *(
        Leak(
            f"names by {kind}",
            "exact-relative",
            (filtered("/diagnostics", NO_NAMES), also("/other")),
            types=(("/other", kind),),
        )
        for kind in (
            "sensor_msgs/BatteryState",
            "sensor_msgs/CameraInfo",
            "sensor_msgs/TimeReference",
            "actionlib_msgs/GoalID",
            "visualization_msgs/Marker",
        )
    ),
    Leak(
        "names of a battery by diagnostics",
        "exact-relative",
        (filtered("/battery", "serial_number: {clear: true}, location: {clear: true}"), also("/diagnostics")),
        types=BATTERY,
    ),
    Leak(
        "a temperature by a humidity",
        "exact-relative",
        (filtered("/air", f"{AIR}, temperature: {{clear: true}}", SECOND), also("/damp")),
        types=(("/air", "sensor_msgs/Temperature"), ("/damp", "sensor_msgs/RelativeHumidity")),
    ),
    Leak(
        "a picture by points, by their name",
        "exact-relative",
        (filtered("/camera", f"data: {SQUARES}", SECOND), also("/depth/points")),
    ),
    Leak("a position by a battery, by its name", "exact-relative", (COARSE, also("/robot/battery"))),
    Leak("the moment by another topic", "presence-open", (KEPT, also("/pose"))),
    Leak(
        "the moment by a topic below",
        "presence-open",
        (KEPT, also("/robot/battery")),
        types=(("/robot/battery", "sensor_msgs/BatteryState"),),
    ),
    Leak("the moment by the graph", "graph-tells", (KEPT, "id: b, who: /x, allow: {graph: ['/**']}")),
    Leak(
        "a name by the graph",
        "graph-tells",
        (filtered("/diagnostics", NO_NAMES), "id: b, who: /x, allow: {graph: [/diagnostics]}"),
    ),
    Leak(
        "how much is withheld by the graph", "graph-tells", (COARSE, "id: b, who: /x, allow: {graph: ['/*']}")
    ),
    *(
        Leak(
            f"the position by {name}",
            "service-tells",
            (COARSE, f"id: b, who: /x, allow: {{call: ['{name}']}}"),
        )
        for name in (
            "/move_base/make_plan",
            "/planner/get_plan",
            "/static_map",
            "/dynamic_map",
            "/robot/get_pose",
            "/move_base/*",
        )
    ),
    Leak(
        "wheels",
        "wheels-open",
        (
            COARSE,
            filtered(
                "/joints",
                f"position: {{round: 0.5}}, velocity: {{clear: true}}, effort: {{clear: true}}, {TIMES}",
                SECOND,
            ),
        ),
    ),
    Leak(
        "rooms of half a metre",
        "rooms-too-small",
        (pose("{rooms: {a1: '0 0, 0.5 0.5', a2: '0.5 0, 1 0.5', hysteresis: 0.5}}"),),
    ),
    Leak(
        "a plan that is shifted",
        "two-versions",
        (
            pose(ROOMS),
            filtered(
                "/goal", f"pose.position: {{rooms: {{k: '1 1, 5 4', hysteresis: 0.5}}}}, {REST}", f", {LIMIT}"
            ).replace("id: a", "id: b"),
        ),
    ),
    Leak(
        "a grid in two frames",
        "two-versions",
        tuple(
            filtered(
                topic,
                f"pose.position: {CELLS}, {REST}",
                f", {LIMIT}, when: 'msg.header.frame_id == \"{frame}\"'",
            ).replace("id: a", f"id: {frame}")
            for topic, frame in (("/pose", "map"), ("/goal", "odom"))
        ),
    ),
    Leak(
        "one pseudonym for all of a pattern",
        "shared-pseudonym",
        (filtered("/diagnostics", HASHED).replace("who: /x", "who: '/phones/*'"),),
    ),
)
UNRELATED = (
    Leak(
        "things that tell nothing of each other",
        "",
        ("id: a, who: /x, allow: {subscribe: [/mic]}, see: {sound: no}", also("/odom, /camera, /map")),
        types=(("/mic", "audio_common_msgs/AudioData"),),
    ),
    Leak(
        "a lamp beside a coarse temperature",
        "",
        ("id: a, who: /x, allow: {subscribe: [/air]}, see: {home: rough}", also("/lamp")),
        "vocabulary: {/lamp: {data: brightness}}\n",
        types=(("/lamp", "std_msgs/Float32"), ("/air", "sensor_msgs/Temperature")),
    ),
    Leak(
        "a battery that is coarse for all it tells",
        "",
        ("id: a, who: /x, allow: {subscribe: [/pose, /battery]}, see: {position: room}",),
        types=(("/battery", "sensor_msgs/BatteryState"),),
    ),
    Leak(
        "services that tell nothing",
        "",
        (COARSE, "id: b, who: /x, allow: {call: [/robot/come, /x/get_pose, /lamp/set]}"),
    ),
    Leak("the graph of other names", "", (COARSE, "id: b, who: /x, allow: {graph: ['/kitchen/**']}")),
    Leak(
        "slots for all",
        "",
        (also("/words, /robot/state", ", filter: {use: presence-only}"),),
        types=(("/robot/state", "std_msgs/String"),),
    ),
    Leak(
        "slots beside another place",
        "",
        (
            also("/bed/weight", ", filter: {use: presence-only}"),
            also("/kitchen/lamp, /clock").replace("id: b", "id: c"),
        ),
        types=(("/bed/weight", "std_msgs/Float32"), ("/kitchen/lamp", "std_msgs/Float32")),
    ),
    Leak(
        "joints that are hidden beside a position",
        "",
        (
            COARSE,
            filtered(
                "/joints", "position: {clear: true}, velocity: {clear: true}, effort: {clear: true}", SECOND
            ),
        ),
    ),
    Leak(
        "a scan beside a blurred picture",
        "",
        (filtered("/camera", f"data: {SQUARES}", SECOND), also("/scan")),
    ),
)
"""Wise ones: what is hidden there is told by nothing else."""
