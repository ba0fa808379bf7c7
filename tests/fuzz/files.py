"""The table of files that the program reads, with the commands that read them; hostile versions of each are tried."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from hypothesis import strategies as st

from controllers.trailer_steering.policy import NETWORK_FILE
from offtrack.exchange.bench.links import DBC_FILE
from offtrack.studies.study import STUDY_FILE
from tests.fuzz.case import Case
from tests.fuzz.mutations import hostile
from tests.fuzz.specimens import FRAMES, SHORT, SHORT_ROVER
from vehicle.foundation.user_file import FileKind, FileType

_STEPS: Final = 40


def settings(*pairs: str) -> tuple[str, ...]:
    return tuple(word for pair in pairs for word in ("--set", pair))


def run(scenario: str, *pairs: str) -> tuple[str, ...]:
    return ("run", scenario, *settings(*pairs), "--no-video", "--quiet", "--out", "out")


def trailer(*pairs: str) -> tuple[str, ...]:
    return run("lane-change", *SHORT, *pairs)


def along(file: str, kind: str = "path") -> tuple[str, ...]:
    return run("lane-change", f"course.kind={kind}", f"course.file={file}", "off_tracking=truth", "speed_kmh=20")


def rover(*pairs: str) -> tuple[str, ...]:
    return run("rover-slope", *SHORT_ROVER, *pairs)


_FINISHED: Final = (("fit-surrogate", "run"), ("draw", "run", "--to", "both", "--out", "out"))
_VIEWED: Final = (
    ("view", "run", "other", "--out", "page.html"),
    ("compare", "other", "run", "--quiet", "--out", "out"),
    ("export", "run", "--out", "out.csv"),
)
_AS_OUT: Final = ("--quiet", "--out", "out")
_ESTIMATE: Final = ("--no-video", *_AS_OUT)
_RAW: Final = ("estimate", "off-tracking", "raw", "--calibration", "raw/rig.toml", *_ESTIMATE)
_STEREO: Final = ("estimate", "off-tracking", "rectified", *_ESTIMATE)
_SLIP: Final = ("estimate", "slip", "sand", *_ESTIMATE)
_CALIBRATE: Final = ("calibrate", "photos", "--board", "7x5", "--square", "0.05", "--quiet", "--out", "camera.toml")
STUDY: Final = (
    *("compare", "lane-change", *settings(*SHORT), "--controllers", "none,command_steer", "--quiet"),
    *("--out", "grid", "--jobs", "1"),
)
TUNING: Final = (
    *("tune", "lane-change", *settings(*SHORT), "--trials", "2", "--seeds", "1", "--judge-seeds", "2", "--quiet"),
    *("--out", "tuning", "--jobs", "1"),
)
BAGS: Final = (  # folders of the specimen, the ending of their file, and its format
    ("plain", ".db3", "database"),
    ("messages", ".db3", "database"),
    ("file", ".zstd", "zstd"),
    ("mcap", ".mcap", "binary"),
    ("ros1", ".bag", "binary"),
)
_ENVIRONMENT: Final = """
import offtrack.environments.registry as made
env = made.single("{name}", {option}="{file}")
env.reset(seed=1)
env.step(env.action_space.sample())
env.close()
"""


class Read(NamedTuple):
    name: str
    kind: FileType | None  # None: of another library's reader, or a module
    specimen: str
    paths: tuple[str, ...]  # of the files in the specimen; names of results may hold *
    format: str
    commands: tuple[tuple[str, ...], ...] = ()
    scripts: tuple[str, ...] = ()


FILES: Final[Sequence[Read]] = (
    Read("vehicle", FileKind.PARAMETERS, "parameters", ("vehicle.toml",), "toml",
         (trailer("vehicle=vehicle.toml"), ("vehicle", "vehicle.toml", *_AS_OUT)),
         tuple(_ENVIRONMENT.format(name=name, option="vehicle", file="vehicle.toml")
               for name in ("TrailerSteering-v0", "TractorTrailerDriving-v0"))),
    Read("rover", FileKind.PARAMETERS, "parameters", ("rover.toml",), "toml",
         (rover("vehicle=rover.toml"), ("vehicle", "rover.toml", *_AS_OUT))),
    Read("soil", FileKind.PARAMETERS, "parameters", ("soil.toml",), "toml", (rover("surface.soil=soil.toml"),)),
    Read("trailer scenario", FileKind.SCENARIO, "parameters", ("trailer_scenario.toml",), "toml",
         (run("trailer_scenario.toml", "off_tracking=truth"), ("keys", "trailer_scenario.toml"))),
    Read("rover scenario", FileKind.SCENARIO, "parameters", ("rover_scenario.toml",), "toml",
         (run("rover_scenario.toml", "slip_estimator=truth"), ("scenarios", "rover_scenario.toml"))),
    Read("study", STUDY_FILE, "parameters", ("study.toml",), "toml", (("sweep", "study.toml", *_AS_OUT),)),
    Read("campaign", STUDY_FILE, "parameters", ("campaign.toml",), "toml", (("campaign", "campaign.toml", *_AS_OUT),)),
    Read("own part", None, "parameters", ("own.py",), "text", (trailer("trailer_steering=own:Law"),)),
    Read("FMU", FileKind.FMU, "ground", ("law.fmu",), "zip", (trailer("trailer_steering=law.fmu"),)),
    Read("CAN bus", DBC_FILE, "ground", ("bus.dbc",), "text", ((*trailer(), "--can", "dbc=bus.dbc"),)),
    Read("demands", FileKind.TABLE, "ground", ("demands.csv",), "text",
         (trailer("outside.demands=trailer", "outside.record=demands.csv"),)),
    Read("drive", FileKind.TABLE, "ground", ("drive.csv",), "text", (trailer("driver.trace=drive.csv"),)),
    Read("path", FileKind.TABLE, "ground", ("path.csv",), "text", (along("path.csv"),)),
    Read("track", FileKind.ROAD, "ground", ("path.gpx",), "text", (along("path.gpx"),)),
    Read("line", FileKind.ROAD, "ground", ("path.geojson",), "json", (along("path.geojson"),)),
    Read("road", FileKind.ROAD, "ground", ("road.xodr",), "text", (along("road.xodr", "opendrive"),)),
    Read("surface", FileKind.SURFACE, "ground", ("surface.crg",), "binary", (trailer("surface.crg=surface.crg"),)),
    Read("surface as text", FileKind.SURFACE, "ground", ("text.crg",), "text",
         (trailer("surface.crg=text.crg"), along("text.crg"))),
    Read("height table", FileKind.TABLE, "ground", ("heights.csv",), "text",
         (rover("surface.height_map=heights.csv"),)),
    Read("height map", FileKind.ARRAY, "ground", ("heights.npy",), "npy", (rover("surface.height_map=heights.npy"),)),
    Read("friction", FileKind.IMAGE, "ground", ("friction.png",), "image",
         (trailer("surface.friction_image=friction.png"),)),
    Read("network", NETWORK_FILE, "ground", ("network.npz",), "zip",
         (trailer("trailer_steering=policy", "policy.path=network.npz"),)),
    Read("stereo image", FileKind.IMAGE, "stereo",
         tuple(f"rectified/image_{side}/{k:06d}.png" for k in (0, 1, FRAMES - 1) for side in (0, 1)), "image",
         (_STEREO,)),
    Read("stereo numbers", FileKind.TABLE, "stereo",
         ("rectified/calib.txt", "rectified/times.txt", "rectified/poses.txt"), "text", (_STEREO,)),
    Read("mount", FileKind.CALIBRATION, "stereo", ("rectified/rig.toml",), "toml", (_STEREO,)),
    Read("calibration", FileKind.CALIBRATION, "stereo", ("raw/rig.toml",), "toml", (_RAW,)),
    Read("sand image", FileKind.IMAGE, "rover", ("sand/images/000000.png", "sand/images/000003.png"), "image",
         (_SLIP,)),
    Read("sand readings", FileKind.TABLE, "rover", ("sand/readings.csv", "sand/slip.csv"), "text", (_SLIP,)),
    Read("sand rig", FileKind.CALIBRATION, "rover", ("sand/rig.toml",), "toml", (_SLIP,)),
    Read("photograph", FileKind.IMAGE, "photographs", ("photos/00.png", "photos/07.png"), "image", (_CALIBRATE,)),
    Read("results", FileKind.SIGNALS, "results", ("run/signals.parquet",), "parquet", _FINISHED),
    Read("result scenario", FileKind.SCENARIO, "results", ("run/scenario.toml",), "toml", _FINISHED),
    Read("study result", FileKind.RECORD, "study", ("grid/cells/*.json",), "json", (STUDY,)),
    Read("study signals", FileKind.SIGNALS, "study", ("grid/cells/*.parquet",), "parquet", (STUDY,)),
    Read("study record", FileKind.RECORD, "study", ("grid/study.toml",), "toml", (STUDY,)),
    Read("tuning", FileKind.RECORD, "study", ("tuning/tuning.toml", "tuning/journal.log"), "text", (TUNING,)),
    Read("training", FileKind.CHECKPOINT, "training", ("training/checkpoint.zip",), "zip",
         (("train", "--out", "training", "--quiet"),)),
    Read("model", FileKind.CHECKPOINT, "training", ("training/checkpoint.zip",), "zip",
         (("benchmark", "roundabouts", "--policy", "training/checkpoint.zip", "--episodes", "1", *_AS_OUT),)),
    Read("others' summary", FileKind.RECORD, "run", ("run/summary.json", "run/manifest.json"), "json", _VIEWED),
    Read("others' page", FileKind.IMAGE, "run", ("run/report.html",), "text", _VIEWED),
    Read("others' signals", FileKind.SIGNALS, "run", ("run/signals.parquet",), "parquet", _VIEWED),
    *(Read(f"bag, {name}", None, "bags", (f"{name}/*{end}",), format_,
           (("estimate", "off-tracking", name, *_ESTIMATE),))
      for name, end, format_ in BAGS),
    Read("foreign calibration", FileKind.CALIBRATION, "foreign", ("raw/stereo.yaml", "raw/stereo.xml"), "text",
         tuple(("estimate", "off-tracking", "raw", "--calibration", f"raw/stereo.{end}", *_ESTIMATE)
               for end in ("yaml", "xml"))),
    Read("video", None, "foreign", ("both.avi",), "binary",
         (("estimate", "off-tracking", "both.avi", "--calibration", "raw/stereo.yaml", *_ESTIMATE),)),
    Read("tyre", FileKind.PARAMETERS, "parameters", ("tyre.tir",), "text", (trailer("vehicle=tyred.toml"),)),
)  # fmt: skip


@st.composite
def hostile_files(draw: st.DrawFn, read: Read, specimens: Path) -> Case:
    folder = specimens / read.specimen
    found = [str(path.relative_to(folder)) for name in read.paths for path in folder.glob(name)]
    name = draw(st.sampled_from(sorted(found)))
    content, note = draw(hostile((folder / name).read_bytes(), read.format))
    readers = [(command, "") for command in read.commands] + [((), script) for script in read.scripts]
    command, script = draw(st.sampled_from(readers))
    return Case(
        kind=f"file: {read.name}",
        command=command,
        script=script,
        files=((name, content),),
        specimen=read.specimen,
        own=read.name == "own part",
        steps=_STEPS,
        note=f"{name}: {note}",
    )
