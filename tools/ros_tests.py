"""ROS's own rospy tests in each form: `tools/ros-tests.sh` fetches them and calls this.

Behind a sidecar everything runs as it is, under `rossec run -- rostest`. In-process rostest, which
is a roslaunch, stays behind a sidecar; the programs it starts are secured by the two lines that a
program would have, put in by a `sitecustomize`.
"""

import argparse
import asyncio
import contextlib
import os
import shutil
import sys
import sysconfig
import tempfile
from collections import Counter
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from grants.model import Right
from tests.support import stock
from tests.support.site import Site

FORMS: Final = ("stock", "sidecar", "in-process")
OPERATOR: Final = "/operator"
UNIT: Final = "/unit"
DEADLINE: Final = 600
TWO_LINES: Final = """
import os, sys
class Securing:
    def find_spec(self, name, path, target=None):
        if name != "rospy":
            return None
        sys.meta_path.remove(self)
        import importlib.util
        spec = importlib.util.find_spec(name)
        stock = spec.loader.exec_module
        def exec_module(module):
            stock(module)
            sys.path[:0] = os.environ["ROSSEC_TESTS_PATH"].split(os.pathsep)
            import rossec
            rossec.secure()
        spec.loader.exec_module = exec_module
        return spec
if "ROSSEC_TESTS_MASTER" in os.environ and not sys.argv[0].endswith("/rostest"):
    os.environ["ROS_MASTER_URI"] = os.environ["ROSSEC_TESTS_MASTER"]
    sys.meta_path.insert(0, Securing())
"""


@dataclass
class Results:
    """The result of each test, by its name; `said` is the first line of the error."""

    passed: set[str] = field(default_factory=set)
    said: dict[str, str] = field(default_factory=dict)

    def take(self, file: str, report: Path) -> None:
        """Read a report in the form that rosunit and pytest write."""
        for case in ElementTree.parse(report).getroot().iter("testcase"):
            name = f"{file}: {report.stem.partition('-')[2]} {case.get('name')}"
            wrong = [*case.iter("failure"), *case.iter("error")]
            if not wrong and not report.name.startswith("rostest-"):  # those say it once more
                self.passed.add(name)
            elif not wrong:
                continue
            else:
                text = f"{wrong[0].get('message') or ''} {wrong[0].text or ''}".strip()
                self.said[name] = text.splitlines()[0][:150] if text else "?"


class Suite:
    """The tests, below a directory that `ros-tests.sh` filled."""

    def __init__(self, work: Path, wanted: Sequence[str]) -> None:
        self.work = work
        self.package = work / "ros_comm" / "test" / "test_rospy"
        self._wanted = wanted

    def _chosen(self, pattern: str) -> list[Path]:
        found = sorted((self.package / "test").glob(pattern))
        return [path for path in found if not self._wanted or path.name in self._wanted]

    @property
    def unit(self) -> list[Path]:
        """Tests of modules."""
        return self._chosen("unit/test_*.py")

    @property
    def launched(self) -> list[Path]:
        """Tests of running nodes: launch files."""
        return self._chosen("rostest/*.test")

    def nodes(self) -> set[str]:
        """The names of all nodes that the launch files start."""
        found: set[str] = set()
        for path in self.launched:
            _names(ElementTree.parse(path).getroot(), "/", found)
        return found

    def environment(self, base: Mapping[str, str]) -> dict[str, str]:
        """What makes ROS find the tests, and `python` ours."""
        work, rostest = self.work, self.work / "debian" / "usr"
        python = (
            work / "site",
            work / "gen",
            rostest / "lib" / "python3" / "dist-packages",
            self.package / "src",
        )
        paths = (self.package.parent, Path("/usr/share"), rostest / "share")
        programs = (Path(sys.executable).parent, rostest / "bin")
        return {
            **base,
            "PYTHONPATH": os.pathsep.join(map(str, python)),
            "ROS_ROOT": "/usr/share/ros",
            "ROS_PACKAGE_PATH": os.pathsep.join(map(str, paths)),
            "PATH": os.pathsep.join((*map(str, programs), os.environ["PATH"])),
        }


def _names(element: ElementTree.Element, space: str, found: set[str]) -> None:
    for child in element:
        inner = space + f"{child.get('ns')}/" if child.get("ns") else space
        if child.tag == "group":
            _names(child, inner, found)
        elif child.tag in {"node", "test"}:
            found.add(inner + str(child.get("name") or child.get("test-name")))


class Form:
    """One way to run them."""

    def __init__(self, name: str, suite: Suite, env: Mapping[str, str]) -> None:
        self.name = name
        self._suite = suite
        self._env = suite.environment(env)
        self._results = Results()

    async def run(self) -> Results:
        """Run all."""
        for path in self._suite.unit:
            await self._unit(path)
        for path in self._suite.launched:
            await self._launched(path)
        return self._results

    def _prefix(self, *options: str) -> tuple[str, ...]:
        return () if self.name == "stock" else (shutil.which("rossec") or "rossec", "run", *options)

    async def _unit(self, path: Path) -> None:
        prefix = self._prefix("--as", UNIT, "--") if self.name == "sidecar" else ()
        options = ("-q", "-s", "-c", os.devnull, "-p", "no:cacheprovider", "-p", "no:asyncio")
        with tempfile.TemporaryDirectory() as directory:
            report = Path(directory) / "report.xml"
            command = (sys.executable, "-m", "pytest", *options, f"--junitxml={report}", str(path))
            env = {**self._env, "ROSSEC_NODE": UNIT, "ROS_LOG_DIR": directory}
            await self._command(path.name, [*prefix, *command], env, directory, [report])

    async def _launched(self, path: Path) -> None:
        options = () if self.name == "stock" else ("--reuse-master", "--clear")
        rostest = self._suite.work / "debian" / "usr" / "bin" / "rostest"
        with tempfile.TemporaryDirectory() as directory:
            command = [
                *self._prefix("--as", OPERATOR, "--each", "--"),
                sys.executable,
                str(rostest),
                *options,
                "--results-base-dir",
                directory,
                str(path),
            ]
            logs = str(self._suite.work / "logs" / self.name / f"{path.name}.d")
            env = {**self._env, "ROS_LOG_DIR": logs, "ROS_HOME": directory}
            await self._command(path.name, command, env, str(path.parent), Path(directory))

    async def _command(
        self,
        name: str,
        command: Sequence[str],
        env: Mapping[str, str],
        where: str,
        reports: Path | Sequence[Path],
    ) -> None:
        process = await asyncio.create_subprocess_exec(
            *command,
            env=dict(env),
            cwd=where,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            start_new_session=True,
        )
        said = b""
        try:
            async with asyncio.timeout(DEADLINE):
                said, _ = await process.communicate()
        except TimeoutError:
            os.killpg(process.pid, 15)
            await process.wait()
        self._log(name, said)
        self._read(name, reports, process.returncode)

    def _read(self, name: str, reports: Path | Sequence[Path], code: int | None) -> None:
        found = sorted(reports.rglob("*.xml")) if isinstance(reports, Path) else reports
        for report in found:
            if report.exists() and report.stat().st_size:
                self._results.take(name, report)
            else:
                self._results.said[f"{name}: all of it"] = f"no report, code {code}"

    def _log(self, name: str, said: bytes) -> None:
        path = self._suite.work / "logs" / self.name / f"{name}.log"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(said)
        sys.stderr.write(f"{self.name}: {name}\n")


@contextlib.asynccontextmanager
async def site_for(suite: Suite, directory: Path) -> AsyncIterator[Site]:
    """A secured master, and an identity with all rights for each node of the tests."""
    site = Site(directory / "site")
    everything = Right(sum(Right))
    for name in sorted({*suite.nodes(), OPERATOR, UNIT}):
        site.grant(name, everything, "/**")
    async with site.running() as running:
        async with running.node(OPERATOR) as operator:
            await operator.params.set("/run_id", "tests")  # as roscore's roslaunch does
        yield running


async def results(suite: Suite, forms: Sequence[str]) -> dict[str, Results]:
    """The results of the tests, in each form."""
    found: dict[str, Results] = {}
    with tempfile.TemporaryDirectory() as temporary:
        directory = Path(temporary)
        for name in forms:
            if name == "stock":
                async with stock.rosmaster(directory) as uri:
                    env = stock.environment(uri, directory)
                    found[name] = await Form(name, suite, env).run()
                continue
            async with site_for(suite, directory / name) as site:
                assert site.master is not None
                env = {**stock.environment(site.master.uri, directory), **site.environ}
                if name == "in-process":
                    env["ROSSEC_TESTS_MASTER"] = site.master.uri
                    ours = (str(Path(__file__).parents[1]), sysconfig.get_path("purelib"))
                    env["ROSSEC_TESTS_PATH"] = os.pathsep.join(ours)
                found[name] = await Form(name, suite, env).run()
    return found


def report(found: Mapping[str, Results]) -> str:
    """The numbers, then every test that does not pass, with the forms in which it does not."""
    lines = [
        f"{form}: {len(each.passed)} of {len(each.passed) + len(each.said)} pass"
        for form, each in found.items()
    ]
    failing = Counter(name for each in found.values() for name in each.said)
    for name in sorted(failing):
        lines.append(f"- {name}")
        lines += [f"    {form}: {each.said[name]}" for form, each in found.items() if name in each.said]
    return "\n".join(lines)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, help="what ros-tests.sh filled")
    parser.add_argument("--form", action="append", choices=FORMS, help="only this one")
    parser.add_argument("files", nargs="*", help="only these test files")
    options = parser.parse_intermixed_args()
    suite = Suite(options.work, options.files)
    (options.work / "site").mkdir(exist_ok=True)
    (options.work / "site" / "sitecustomize.py").write_text(TWO_LINES)
    found = asyncio.run(results(suite, options.form or FORMS))
    sys.stdout.write(report(found) + "\n")


if __name__ == "__main__":
    main()
