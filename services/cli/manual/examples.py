"""The commands by panel, in the order of the help, with examples that the help shows. A test reads each of them."""

from typing import NamedTuple

RUN, LOOK, STUDY, SECURE, SYSTEM = (
    "Run a radar",
    "Look at a run",
    "Study many runs",
    "Secure it",
    "Processes, machines and tests",
)


class Shown(NamedTuple):
    """How a command stands in the help."""

    panel: str
    examples: tuple[str, ...]  # without the name of the program; short enough for 80 columns


COMMANDS = {
    "run": Shown(
        RUN,
        (
            "run paper",
            "run paper --strategy uniform --seed 7 --store build/run.db",
            "run traffic --pace realtime --rate 5 --keep",
            "run paper --in-process --set radar.array.n_tx=32",
        ),
    ),
    "scenarios": Shown(RUN, ("scenarios", "scenarios --show paper")),
    "sky": Shown(
        RUN,
        (
            "sky --aircraft 12 --minutes 10 --out sky.toml",
            "sky --from positions.csv --origin 48.35,11.79 --out sky.toml",
        ),
    ),
    "check": Shown(RUN, ("check my.toml", "check paper --set radar.echo.amplitude_db=55", "check my_rule.py")),
    "new": Shown(RUN, ("new rule my_rule.py", "new disturbance my_sea.py")),
    "command": Shown(RUN, ("command RUN power 0.5", "command RUN sector blank -20 -10", "command RUN end")),
    "cancel": Shown(RUN, ("cancel RUN --connect tcp/127.0.0.1:7447",)),
    "query": Shown(
        LOOK,
        (
            "query runs --store build/run.db",
            "query p_d --target 2 --dwells 281:300 --store build/run.db",
            "query tracks --csv --connect tcp/127.0.0.1:7447",
        ),
    ),
    "export": Shown(
        LOOK,
        ("export --store build/run.db --out run.csv", "export --store build/run.db --what detections --out d.parquet"),
    ),
    "figures": Shown(LOOK, ("figures build/run.db --out figures",)),
    "feed": Shown(LOOK, ("feed --to asterix --out udp://127.0.0.1:8600", "feed --to geojson --out maps")),
    "replay": Shown(LOOK, ("replay --store build/run.db --to planner",)),
    "campaign": Shown(
        STUDY, ("campaign paper --runs 20 --store paper.db", "campaign paper --runs 20 --store paper.db --resume")
    ),
    "sweep": Shown(
        STUDY,
        (
            "sweep paper --over radar.planner.looks=single,joint --store looks.db",
            "sweep paper --over radar.array.n_tx=16,32 --store n.db --out figures",
        ),
    ),
    "report": Shown(STUDY, ("report paper.db", "report paper.db --strategy power-aware --json")),
    "store": Shown(
        STUDY,
        (
            "store check runs.db",
            "store copy runs.db postgresql://radar@db.example/radar",
            "store delete runs.db paper-0123456789ab",
        ),
    ),
    "certs": Shown(SECURE, ("certs init", "certs issue planner.a", "certs issue router --host radar.example")),
    "service": Shown(
        SYSTEM,
        (
            "service router",
            "service recorder --store runs.db",
            "service planner --name a --connect tcp/127.0.0.1:7447",
        ),
    ),
    "schema": Shown(SYSTEM, ("schema --out asyncapi.json", "schema --format jsonschema")),
    "calibrate": Shown(SYSTEM, ("calibrate noise.npy paper", "calibrate target.npy paper --bearing 10 --range 40")),
    "verify": Shown(SYSTEM, ("verify",)),
    "bench": Shown(SYSTEM, ("bench kernels pomcp mode", "bench dwell")),
    "chaos": Shown(SYSTEM, ("chaos smoke --runs 20", "chaos traffic --pace realtime --rate 4")),
    "simulate": Shown(SYSTEM, ("simulate --schedules 1000", "simulate --replay 400")),
}


def epilog(name: str) -> str:
    """The examples of a command, a line each."""
    return "\n\n".join(["Examples:", *(f"  cogradar {example}" for example in COMMANDS[name].examples)])
