"""Debian's larger programs on two hosts, unmodified: nodelets, tf2, rviz, and the libraries of rqt.

rqt itself is not in Debian 12; its plugins use the libraries that are called here.
"""

import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.sidecarworld import Running, World, wait
from tests.support import rospyuse
from tests.support.hosts import two_hosts
from tests.support.roscpp import compiled, nodelet
from tests.support.site import Site
from tests.support.xserver import x_server

NODELET = "/usr/lib/nodelet/nodelet"
ECHO = "/usr/lib/tf2_tools/echo.py"
STATIC = "/usr/lib/tf2_ros/static_transform_publisher"
RVIZ = """
Visualization Manager:
  Displays:
    - {Class: rviz/TF, Enabled: true, Name: TF, Value: true}
    - {Class: rviz/Marker, Enabled: true, Marker Topic: /markers, Name: Marker, Value: true}
  Global Options: {Background Color: 0; 0; 0, Fixed Frame: map, Frame Rate: 5}
  Tools: [{Class: rviz/SetGoal, Topic: /goal}]
  Views: {Current: {Class: rviz/TopDownOrtho, Scale: 50, Name: Current View}}
Window Geometry: {Height: 400, Width: 400}
"""
MAGENTA = b"\xff\0\xff\xff"  # of the markers, as the memory of the screen holds it

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def programs(request: pytest.FixtureRequest) -> Path:
    return request.config.cache.mkdir("roscpp")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("sidecar_programs")
    with two_hosts() as hosts:
        world = World(hosts, Site(directory / "site"), directory)
        world.enroll("/talker", publish="/chatter", provide="/talker/say")
        world.enroll("/rostopic", wildcard=True, subscribe="/**", graph="/**")
        world.enroll("/rosservice", wildcard=True, call="/**", graph="/**")
        with world.master():
            yield world


@pytest.fixture(scope="module")
def talker(world: World, programs: Path) -> Iterator[Running]:
    program = str(compiled(programs))
    with world.secured(world.hosts.near, program, "talker", "/chatter") as running:
        yield running


def test_nodelets_are_loaded_from_another_host(world: World, talker: Running, programs: Path) -> None:
    """Two in one manager connect inside it; all other connections go through sidecars."""
    bond = "/manager/bond"
    for name in ("/first", "/second"):
        world.enroll(name, publish=bond, subscribe=bond, call="/manager/*")
    world.enroll(
        "/manager",
        publish=f"{bond} /first/out /second/out",
        provide="/manager/*",
        subscribe=f"{bond} /chatter /first/out",
    )
    package = nodelet(programs, world.directory / "packages" / "shout")
    path = f"ROS_PACKAGE_PATH={package.parent}:/usr/share"
    near, far = world.hosts.near, world.hosts.far
    load = (NODELET, "load", "shout/Shout", "manager")
    first, second = ("__name:=first", "in:=/chatter"), ("__name:=second", "in:=/first/out")
    with (
        world.secured(far, "env", path, NODELET, "manager", "__name:=manager"),
        world.secured(near, *load, *first),
        world.secured(near, *load, *second) as loader,
    ):
        heard = world.tool("rostopic", "echo", "-n", "2", "/second/out")
        assert heard.count("!!") == 2, heard
        loader.end(signal.SIGINT)
        wait(lambda: "/second/out" not in world.tool("rostopic", "list"))
        assert "/first/out" in world.tool("rostopic", "list")


def test_tf2_transforms_arrive(world: World) -> None:
    """A static transform is latched; a late subscriber receives it too."""
    world.enroll("/static_transform_publisher", wildcard=True, publish="/tf_static")
    frames = "/echo/tf2_frames"  # tf2's buffer provides it, and looks it up first
    world.enroll("/echo", subscribe="/tf /tf_static", provide=frames, call=frames)
    near, far = world.hosts.near, world.hosts.far
    with (
        world.secured(near, STATIC, "0", "0", "2.5", "0", "0", "0", "base", "camera"),
        world.secured(far, sys.executable, ECHO, "base", "camera") as echo,
    ):
        echo.wait_for("- Translation: [0.000, 0.000, 2.500]")


def test_rviz_draws_what_another_host_publishes(world: World) -> None:
    """Markers in a transformed frame; the screen shows them."""
    world.enroll("/painter", publish="/markers")
    world.enroll("/mount", publish="/tf /tf_static")
    world.enroll(
        "/rviz",
        wildcard=True,
        subscribe="/tf /tf_static /markers /markers_array",
        publish="/goal",
        provide="/*/load_config /*/load_config_discarding_changes /*/reload_shaders /*/save_config",
    )
    near, far = world.hosts.near, world.hosts.far
    config = world.directory / "test.rviz"
    config.write_text(RVIZ)
    pixels = world.directory / "Xvfb_screen0"
    screen = x_server("-nolisten", "tcp", "-fbdir", str(world.directory))
    python = (sys.executable, "-c")
    with (
        world.started(far, *screen) as display,
        world.secured(near, *python, rospyuse.MARKERS),
        world.secured(near, *python, rospyuse.TF_BROADCASTER),
    ):
        wait(lambda: display.said.strip().isdecimal())
        where = f"DISPLAY=:{display.said.strip()}"
        with world.secured(far, "env", where, "rviz", "-d", str(config)) as rviz:
            wait(lambda: pixels.read_bytes().count(MAGENTA) > 10_000 or rviz.process.poll())
            assert rviz.process.poll() is None, rviz.said


def test_the_calls_of_rqt_are_answered(world: World, talker: Running, programs: Path) -> None:
    world.enroll("/listener", subscribe="/chatter", provide="/listener/say")
    world.enroll("/drive", publish="/drive/*", provide="/drive/*", param_set="/drive/*")
    rqt = "/rqt_gui_py_node"
    world.enroll(rqt, wildcard=True, subscribe="/**", publish="/aim", graph="/**", call="/**")
    near, far = world.hosts.near, world.hosts.far
    python = (sys.executable, "-c")
    with (
        world.secured(far, str(compiled(programs)), "listener", "/chatter"),
        world.secured(near, *python, rospyuse.RECONFIGURE_SERVER) as drive,
    ):
        drive.wait_for("READY")
        lines = world.tool(*python, rospyuse.RQT, options=("--as", rqt)).splitlines()
        assert lines.pop(7).startswith("ROSOUT /")
        assert lines == [
            "GRAPH /talker /chatter /listener set()",
            "NODES True True",
            "TOPIC std_msgs/String /chatter hello",
            "HZ True",
            "SERVICE True SetLoggerLevel",
            "PROVIDER /talker",
            "RECONFIGURE ['/drive']",
            "PARAMETERS []",
        ]
