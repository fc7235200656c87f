"""Policies with one leak each, and the code that lint must give: no other, and not none.

Most were measured by attackers' programs (docs/spec/policy.md, "Lint"): what a receiver learns
though a filter hides it. `WISE` are policies that hide what they say, and must give no advice.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Leak:
    """Rules, and the codes expected."""

    name: str
    codes: str
    rules: tuple[str, ...]
    head: str = ""
    types: tuple[tuple[str, str], ...] = ()


CELLS = "{round: {step: 2, hysteresis: 0.5}}"
ROOMS = "{rooms: {kitchen: '0 0, 4 3', hysteresis: 0.5}}"
TIMES = "header.stamp: {round: 10}, header.seq: {clear: true}"
REST = f"pose.orientation: {{clear: true}}, {TIMES}"
LIMIT = "limit: {rate: 0.2}"
SECOND = ", limit: {rate: 1}"
SQUARES = "{pixelate: {across: 16, block: 32, levels: 8}}"
COARSE = (
    f"id: coarse, who: /x, allow: {{subscribe: [/pose]}}, {LIMIT}, filter: {{pose.position: {CELLS}, {REST}}}"
)
POSE = f"pose.pose.position: {CELLS}"
TURN = "pose.pose.orientation: {clear: true}"
SPREAD = "pose.covariance: {clear: true}"


def pose(position: str, rest: str = REST, limit: str = LIMIT) -> str:
    """A rule on /pose with this treatment of the position."""
    more = f", {limit}" if limit else ""
    return filtered("/pose", f"pose.position: {position}, {rest}", more)


def filtered(topic: str, fields: str, more: str = "") -> str:
    return f"id: a, who: /x, allow: {{subscribe: [{topic}]}}, filter: {{{fields}}}{more}"


def also(topic: str, more: str = "") -> str:
    return f"id: b, who: /x, allow: {{subscribe: [{topic}]}}{more}"


CLEARED = "header: {clear: true}, pose: {clear: true}"
KEY = f"sha256:{'ab' * 32}"
OWNER = f"identities: {{phone: {{node: /phone, key: '{KEY}'}}, tablet: {{node: /tablet, key: '{KEY}'}}}}\n"
FOR_PHONE = COARSE.replace("who: /x", "who: phone")
GRID = "{round: {step: 3, hysteresis: 1}}"
PERSONAL = "{hash: {key: k, per: receiver}}"
HASHED = "status[*].name: {clear: true}, status[*].hardware_id: {hash: k}"
COARSE_ON_TABLET = (
    f"id: b, who: tablet, allow: {{subscribe: [/pose]}}, {LIMIT}, filter: {{pose.position: {GRID}, {REST}}}"
)

CONDITIONS = (
    Leak(
        "a condition on a rounded position",
        "condition-tells",
        (pose(CELLS) + ", when: 'msg.pose.position.x < 5.0'",),
    ),
    Leak(
        "a condition on a cleared position",
        "condition-tells",
        (filtered("/pose", CLEARED, f", {LIMIT}, when: 'msg.pose.position.x < 5.0'"),),
    ),
    Leak(
        "a condition on a cleared frame, as in the README",
        "condition-tells",
        (
            pose(CELLS, f"header.frame_id: {{clear: true}}, {REST}")
            + ", when: 'msg.header.frame_id == \"map\"'",
        ),
    ),
    Leak(
        "a condition of another rule of the same receiver",
        "condition-tells",
        (COARSE, also("/pose", ", when: '1 in [1] && !(msg.pose.position.y + 1.0 > 2.0)'")),
    ),
    Leak(
        "half planes for two receivers",
        "condition-tells",
        (
            filtered("/pose", CLEARED, f", {LIMIT}, when: 'msg.pose.position.x < 5.0'"),
            filtered("/pose", CLEARED, f", {LIMIT}, when: 'msg.pose.position.x < 6.0'").replace(
                "id: a, who: /x", "id: b, who: /y"
            ),
        ),
    ),
    Leak(
        "a condition on a part of a text",
        "condition-tells",
        (
            filtered(
                "/words", "data: {truncate: 0}", ", limit: {rate: 0.1}, when: 'msg.data.startsWith(\"fall\")'"
            ),
        ),
    ),
)
FIELDS = (
    Leak(
        "velocity", "movement-open", (filtered("/odom", f"{POSE}, {TURN}, {SPREAD}, {TIMES}", f", {LIMIT}"),)
    ),
    Leak("velocity beside a cleared position", "movement-open", (filtered("/odom", "pose: {clear: true}"),)),
    Leak("velocity of joints", "movement-open", (filtered("/joints", f"position: {{round: 0.5}}, {TIMES}"),)),
    Leak("orientation", "heading-open", (pose(CELLS, TIMES),)),
    Leak(
        "covariance", "covariance-open", (filtered("/amcl_pose", f"{POSE}, {TURN}, {TIMES}", f", {LIMIT}"),)
    ),
    Leak("stamps", "time-open", (pose(CELLS, "pose.orientation: {clear: true}, header.seq: {clear: true}"),)),
    Leak("counts", "time-open", (pose(CELLS, "pose.orientation: {clear: true}, header.stamp: {round: 10}"),)),
    Leak(
        "one coordinate",
        "position-open",
        (filtered("/pose", f"pose.position.x: {CELLS}, {REST}", f", {LIMIT}"),),
    ),
    Leak(
        "names that occur once", "name-open", (filtered("/diagnostics", "status[*].hardware_id: {hash: k}"),)
    ),
)
PARAMETERS = (
    Leak("no hysteresis", "no-hysteresis", (pose("{round: 2}"),)),
    Leak("no rate", "no-rate", (pose(CELLS, limit=""),)),
    Leak("rooms without a rate", "no-rate", (pose(ROOMS, limit=""),)),
    Leak(
        "nothing but that it was sent, at the full rate",
        "no-rate",
        (filtered("/words", "data: {clear: true}"),),
    ),
    Leak(
        "NavSatFix without hysteresis",
        "no-hysteresis",
        (
            filtered(
                "/fix",
                "latitude: {round: 0.01}, longitude: {round: 0.01}, altitude: {clear: "
                f"true}}, position_covariance: {{clear: true}}, {TIMES}",
                f", {LIMIT}",
            ),
        ),
    ),
    Leak(
        "NavSatFix without rate",
        "no-rate",
        (
            filtered(
                "/fix",
                "latitude: {round: {step: 0.01, hysteresis: 0.002}}, longitude: {round: "
                "{step: 0.01, hysteresis: 0.002}}, altitude: {clear: true}, "
                f"position_covariance: {{clear: true}}, {TIMES}",
            ),
        ),
    ),
    Leak("ranges of a scan", "rounded-array", (filtered("/scan", "ranges: {round: 1}"),)),
    Leak(
        "points of a plan",
        "rounded-array",
        (
            filtered(
                "/plan",
                f"poses[*].pose: {{round: 2}}, poses[*].header: {{clear: true}}, {TIMES}",
                f", {LIMIT}",
            ),
        ),
    ),
    Leak("a rate of 10 for a topic of 10", "rate-does-nothing", (pose(CELLS, limit="limit: {rate: 10}"),)),
    Leak(
        "a hysteresis of a millimetre",
        "hysteresis-does-nothing",
        (pose("{round: {step: 2, hysteresis: 0.001}}"),),
    ),
    Leak(
        "/odom at a millimetre",
        "step-does-nothing",
        (filtered("/odom", "pose.pose.position: {round: 0.001}"),),
    ),
    Leak("joints at a milliradian", "step-does-nothing", (filtered("/joints", "position: {round: 0.001}"),)),
    Leak("squares of 4 pixels", "pixels-too-small", (filtered("/camera", "data: {pixelate: 4}"),)),
    Leak(
        "squares of colours",
        "no-grey-levels",
        (filtered("/camera", "data: {pixelate: {across: 16}}", SECOND),),
    ),
    Leak(
        "squares of a hundred greys",
        "no-grey-levels",
        (filtered("/camera", "data: {pixelate: {across: 20, levels: 100}}", SECOND),),
    ),
    *(
        Leak(
            f"squares of {size} pixels",
            code,
            (filtered("/camera", f"data: {{pixelate: {{block: {size}, levels: 8}}}}", SECOND),),
        )
        for size, code in (
            (16, "pixels-too-small"),
            (24, "pixels-too-small"),
            (32, "pixels-fixed"),
            (100, "pixels-fixed"),
        )
    ),
    Leak(
        "forty squares across",
        "pixels-too-small",
        (filtered("/camera", "data: {pixelate: {across: 40, levels: 8}}", SECOND),),
    ),
    Leak(
        "a region alone",
        "region-open",
        (
            filtered(
                "/camera", "data: {pixelate: {across: 8, levels: 8, x: 0, y: 0, width: 9, height: 9}}", SECOND
            ),
        ),
    ),
    Leak("every picture in squares", "no-rate", (filtered("/camera", f"data: {SQUARES}"),)),
    Leak(
        "rooms without hysteresis",
        "no-hysteresis",
        (pose("{rooms: {hall: '0 0, 4 3', kitchen: '4 0, 9 3'}}"),),
    ),
    Leak("clamped", "clamp-keeps-values", (filtered("/pose", "pose.position: {clamp: [-100, 100]}"),)),
)
RELATIVES = (
    *(
        Leak(f"{topic} seen exactly", "exact-relative", (COARSE, also(topic)))
        for topic in (
            "/odom",
            "/amcl_pose",
            "/scan",
            "/cloud",
            "/plan",
            "/particles",
            "/cmd_vel",
            "/camera",
            "/camera2",
            "/fix",
            "/goal",
            "/joints",
            "/tf",
        )
    ),
    Leak(
        "a local map",
        "exact-relative",
        (COARSE, also("/local_costmap/costmap")),
        types=(("/local_costmap/costmap", "nav_msgs/OccupancyGrid"),),
    ),
    Leak(
        "where localisation saves it",
        "exact-relative",
        (COARSE, "id: b, who: /x, allow: {param-get: ['/**']}"),
    ),
    Leak("by its name, without a type", "exact-relative", (COARSE, also("/robot/odom"))),
    Leak("everything", "exact-relative", (COARSE, also("'/**'"))),
    Leak("for everybody", "exact-relative", (COARSE, "id: b, who: '*', allow: {subscribe: [/odom]}")),
    Leak(
        "by a key",
        "exact-relative",
        (COARSE, "id: b, who: pinned, allow: {subscribe: [/odom]}"),
        f"identities: {{pinned: {{node: /x, key: '{KEY}'}}}}\n",
    ),
    Leak("if a person approves", "exact-relative", (COARSE, "id: b, who: /x, prompt: {subscribe: [/odom]}")),
    Leak(
        "/odom at a millimetre beside /pose",
        "exact-relative step-does-nothing",
        (COARSE, filtered("/odom", "pose.pose.position: {round: 0.001}")),
    ),
    Leak(
        "another camera",
        "exact-relative",
        (filtered("/camera", f"data: {SQUARES}", SECOND), also("/camera2")),
    ),
    Leak(
        "other diagnostics",
        "exact-relative",
        (
            filtered("/diagnostics", "status[*].name: {clear: true}, status[*].hardware_id: {clear: true}"),
            also("/diag2"),
        ),
        types=(("/diag2", "diagnostic_msgs/DiagnosticArray"),),
    ),
    Leak("all of a namespace", "unknown-type", (COARSE, also("'/home/**'"))),
    Leak(
        "beside a level",
        "exact-relative",
        ("id: a, who: /x, allow: {subscribe: [/pose]}, see: {position: room}", also("/odom")),
    ),
    Leak(
        "a type nothing is known of, beside a level",
        "unknown-type",
        ("id: a, who: /x, allow: {subscribe: [/pose, /odd]}, see: {/pose: {position: area}}",),
        types=(("/odd", "dynamic_reconfigure/Config"),),
    ),
    Leak(
        "a type of which the policy says that it tells the position",
        "exact-relative",
        (COARSE, also("/bed")),
        "vocabulary: {/bed: {data: position}}\n",
        types=(("/bed", "std_msgs/Float32"),),
    ),
    Leak("a type not given", "unknown-type", (COARSE, also("/secret"))),
    Leak(
        "a type nothing is known of",
        "unknown-type",
        (COARSE, also("/odd")),
        types=(("/odd", "dynamic_reconfigure/Config"),),
    ),
    Leak(
        "two grids",
        "two-versions",
        (COARSE, filtered("/goal", f"pose.position: {GRID}, {REST}", f", {LIMIT}")),
    ),
    Leak("two grids of one owner", "two-versions", (FOR_PHONE, COARSE_ON_TABLET), OWNER),
    Leak(
        "one key for two receivers",
        "shared-pseudonym",
        (
            filtered("/diagnostics", HASHED),
            filtered("/diagnostics", HASHED).replace("id: a, who: /x", "id: b, who: /y"),
        ),
    ),
    Leak(
        "two nodes of one key",
        "second-receiver",
        (FOR_PHONE, "id: b, who: tablet, allow: {subscribe: [/pose]}"),
        OWNER,
    ),
    Leak(
        "a node and one below it",
        "second-receiver",
        (COARSE, "id: b, who: /x/app, allow: {subscribe: [/odom]}"),
    ),
    Leak(
        "two nodes of one domain",
        "second-receiver",
        (
            COARSE.replace("/x", "'hospital:/rounds/*'"),
            "id: b, who: 'hospital:/nurse', allow: {subscribe: [/odom]}",
        ),
    ),
)
RULES = (
    Leak("no reason", "no-reason", ("no reason: id: a, who: /x, allow: {call: /b}",)),
    Leak("more than a year", "long-lifetime", ("id: a, who: /x, allow: {call: /b}, renew_until: 60w",)),
    Leak("every arm", "wide-right", ("id: a, who: /x, allow: {publish: ['/arm/**']}",)),
    Leak("every parameter", "wide-right", ("id: a, who: /x, prompt: {param-set: ['/**']}",)),
    Leak(
        "each other's poses", "speaks-for-others", ("id: a, who: '/robots/*', allow: {publish: ['/*/pose']}",)
    ),
    Leak(
        "each other's poses, below a namespace",
        "speaks-for-others",
        ("id: a, who: '/site/robots/*', allow: {publish: ['/site/robots/*/pose']}",),
    ),
    Leak(
        "each other's services",
        "speaks-for-others",
        ("id: a, who: [/one, /two], allow: {provide: ['/*/get_loggers']}",),
    ),
    Leak(
        "a right that is denied",
        "never-decides",
        ("id: a, who: /x, allow: {call: /b}", "id: no, who: '*', deny: {call: ['/**']}"),
    ),
    Leak(
        "a prompt that is allowed",
        "never-decides",
        ("id: a, who: /x, prompt: {call: /b}", "id: b, who: '/*', allow: {call: ['/*']}"),
    ),
    Leak(
        "an identity",
        "unused-identity",
        ("id: a, who: /x, allow: {call: /b}",),
        "identities: {i: {node: /i}}\n",
    ),
    Leak("a group", "unused-group", ("id: a, who: /x, allow: {call: /b}",), "groups: {g: [/x, /y]}\n"),
    Leak(
        "a filter",
        "unused-filter",
        ("id: a, who: /x, allow: {call: /b}",),
        "filters: {f: {data: {clear: true}}}\n",
    ),
    Leak("a type", "unused-type", ("id: a, who: /x, allow: {call: /b}",), types=(("/c", "std_msgs/String"),)),
    Leak(
        "a connection that stays",
        "keep-when-stale",
        ("id: a, who: /x, allow: {subscribe: /stop}, on_stale: keep",),
    ),
)
LEAKS = (*CONDITIONS, *FIELDS, *PARAMETERS, *RELATIVES, *RULES)
NO_ODOM = "id: d, who: /x, deny: {subscribe: [/odom]}"
WISE = (
    Leak("rounded, with all that belongs to it", "", (COARSE,)),
    Leak("a topic of another kind", "", (COARSE, also("/words, /map, /clock, /rosout"))),
    Leak("what is sent to the receiver", "", (COARSE, also("/x/orders"))),
    Leak("exact for another node", "", (COARSE, "id: b, who: /y, allow: {subscribe: [/odom]}")),
    Leak(
        "exact for a neighbour",
        "",
        (COARSE.replace("/x", "/a/x"), "id: b, who: /a/y, allow: {subscribe: [/odom]}"),
    ),
    Leak("denied", "", (COARSE, "id: b, who: '/*', allow: {subscribe: [/odom]}", NO_ODOM)),
    Leak("a condition on what is seen", "", (COARSE + ", when: 'msg.header.frame_id == \"map\"'",)),
    Leak("a condition on the time", "", (COARSE + ", when: 'now.getHours() > 6'",)),
    Leak("its own parameters", "", (COARSE, "id: b, who: /x, allow: {param-get: [~/**]}")),
    Leak(
        "a region without a filter",
        "",
        ("id: a, who: /x, allow: {subscribe: [/pose]}, when: 'msg.pose.position.x < 5.0'",),
    ),
    Leak("rooms", "", (pose(ROOMS),)),
    Leak("slots", "", (also("/words", ", filter: {use: presence-only}"),)),
    Leak(
        "steps that nest",
        "",
        (
            COARSE,
            filtered("/goal", "pose.position: {round: {step: 4, hysteresis: 1}}, " + REST, f", {LIMIT}"),
        ),
    ),
    Leak(
        "the preset on all topics of a position",
        "",
        (also("/pose, /odom, /amcl_pose", ", filter: {use: coarse-position}"),),
    ),
    Leak(
        "joints",
        "",
        (
            filtered(
                "/joints",
                f"position: {{round: 0.5}}, velocity: {{clear: true}}, effort: {{clear: true}}, {TIMES}",
            ),
        ),
    ),
    Leak("a smaller scan", "", (filtered("/scan", "ranges: {clamp: [0, 5]}"),)),
    Leak("a rate alone", "", ("id: a, who: /x, allow: {subscribe: [/camera]}, limit: {rate: 30}",)),
    Leak("own names", "", ("id: a, who: '/x/**', allow: {publish: ['/x/**'], provide: ['/x/*/go']}",)),
    Leak(
        "a group",
        "",
        (COARSE.replace("/x", "g"), "id: b, who: g, allow: {subscribe: [/map]}"),
        "groups: {g: [/x, /y]}\n",
    ),
    Leak(
        "a type of which the policy says what it tells",
        "",
        (COARSE, also("/lamp")),
        "vocabulary: {/lamp: {data: brightness}}\n",
        types=(("/lamp", "std_msgs/Float32"),),
    ),
    Leak(
        "the own names of each",
        "",
        ("id: a, who: '/robots/*', allow: {publish: ['{node}/pose', ~/**], provide: [~/get]}",),
    ),
    Leak(
        "own names that are coarse",
        "",
        ("id: a, who: '/robots/*', allow: {subscribe: [~/p]}, filter: {use: coarse-position}",),
        types=(("{node}/p", "geometry_msgs/PoseStamped"),),
    ),
    Leak(
        "a pseudonym for each receiver",
        "",
        (
            filtered("/diagnostics", HASHED.replace("{hash: k}", PERSONAL)),
            filtered("/diagnostics", HASHED.replace("{hash: k}", PERSONAL)).replace(
                "id: a, who: /x", "id: b, who: /y"
            ),
        ),
    ),
    Leak("one node for many", "", ("id: a, who: /sim, allow: {publish: ['/*/pose']}",)),
    Leak("a shared topic", "", ("id: a, who: '/robots/*', allow: {publish: [/tf]}",)),
    Leak(
        "a denial with an exception",
        "",
        ("id: a, who: '/x/*', allow: {call: /b}", "id: no, who: '*', except: /x/one, deny: {call: [/b]}"),
    ),
    Leak(
        "a prompt beside an allowance of less",
        "",
        ("id: a, who: /x, prompt: {call: ['/b/*']}", "id: b, who: /x, allow: {call: [/b/one]}"),
    ),
)

HOME = """rossec: 1
robot: home-robot
basics: true
defaults: {decision: prompt, lifetime: 7d, renew_until: 180d}
types:
  /robot/pose: geometry_msgs/PoseStamped
  /robot/odom: nav_msgs/Odometry
  /robot/camera: sensor_msgs/Image
rules:
  - id: robot
    why: it moves and sees
    who: /robot
    allow: {publish: [~/pose, ~/odom, ~/camera, /tf], provide: [~/come], subscribe: [/cmd_vel]}
  - id: heating
    why: empty rooms are lowered
    who: /heating
    allow: {subscribe: [/robot/pose], publish: [~/**], provide: [~/set_target]}
    see: {position: room}
  - id: doctor
    why: whether somebody has fallen
    who: /doctor
    allow: {subscribe: [/robot/pose, /robot/camera]}
    see: {position: room, image: blurred}
  - id: guest
    why: may call the robot
    who: /guest/*
    allow: {call: [/robot/come], subscribe: [/robot/pose]}
    see: {position: area}
    lifetime: 2h
  - id: rviz
    why: the owner looks
    who: /rviz
    allow: {subscribe: ["/robot/*", /tf, /cmd_vel], publish: [/cmd_vel]}
"""
