"""Registry of commands: where each is, and its line in the help of the program.

A command's module is loaded when the command runs, or its own help is asked for.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandEntry:
    """A command that is loaded when it is needed.

    Attributes
    ----------
    place : str
        "package.module:attribute" of the click command.
    line : str
        First sentence of its help.
    """

    place: str
    line: str


COMMANDS = {
    "certify": CommandEntry(
        place="experiments.cli.certify:certify",
        line="The best layout over all worlds that may turn out to be.",
    ),
    "city": CommandEntry(
        place="experiments.city.command:city",
        line="Choose units for the junctions of a city under one budget.",
    ),
    "compare": CommandEntry(
        place="experiments.cli.evaluate:compare",
        line="Compare layouts on the same runs: the first against each of the others.",
    ),
    "completion": CommandEntry(
        place="experiments.cli.completion:completion",
        line="Print what makes a shell complete commands, options and their words.",
    ),
    "dataset": CommandEntry(
        place="experiments.perception_lab.commands:dataset",
        line="Write a dataset: what cameras see of all runs, with labels.",
    ),
    "detector": CommandEntry(
        place="experiments.perception_lab.commands:detector",
        line="Response tables of detectors.",
    ),
    "doctor": CommandEntry(
        place="experiments.cli.doctor:doctor",
        line="Say what is installed here, what is missing, and what that costs.",
    ),
    "evaluate": CommandEntry(
        place="experiments.cli.evaluate:evaluate",
        line="Evaluate a layout by perception and braking, or recorded detections.",
    ),
    "export": CommandEntry(
        place="experiments.cli.export:export",
        line="Write a layout in a format that other programs read.",
    ),
    "latency": CommandEntry(
        place="experiments.cli.latency:latency",
        line="How much latency a layout bears.",
    ),
    "pareto": CommandEntry(
        place="experiments.cli.pareto:pareto",
        line="What each further unit, or more money, buys.",
    ),
    "plan": CommandEntry(
        place="experiments.planner.command:plan",
        line="Plan by hand in the browser: mount sensors, drag them, see at once who is"
        " saved.",
    ),
    "render": CommandEntry(
        place="experiments.perception_lab.commands:render",
        line="Render what a camera sees in one frame (colours, instances, depths).",
    ),
    "retrofit": CommandEntry(
        place="experiments.cli.pareto:retrofit",
        line="What to change about units that are mounted.",
    ),
    "scenarios": CommandEntry(
        place="experiments.cli.scenarios:scenarios",
        line="What is driven at the junction: list it, look at it, export it.",
    ),
    "scene": CommandEntry(
        place="experiments.scene.command:scene",
        line="Scenes: cut out of maps, looked at, checked.",
    ),
    "sheet": CommandEntry(
        place="experiments.cli.export:sheet",
        line="Write a PDF for whoever mounts the units: a page each.",
    ),
    "solve": CommandEntry(
        place="experiments.cli.solve:solve",
        line="Solve a placement problem from a file, and prove it.",
    ),
    "verify": CommandEntry(
        place="experiments.cli.verify:verify",
        line="Check a folder of results, without the optimiser.",
    ),
}

RECORDED = "experiments.cli.recording:evaluate_recording"
"""What answers in place of a command that is given ``--recording``."""
