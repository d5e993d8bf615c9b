"""Help in sections: options stand under what they are about, whatever command they belong to."""

import click

_SECTIONS = {
    "What is asked": (
        "budget",
        "budget_cost",
        "target",
        "least",
        "min_case_apr",
        "survive",
        "stage_weights",
    ),
    "What may be mounted, and where": (
        "keep",
        "within",
        "force_site",
        "forbid_site",
        "site_capacity",
        "site_cost_eur",
        "separation_m",
        "sensors",
        "no_look",
        "no_look_share",
        "no_look_price",
        "study_poses",
    ),
    "How it is looked for": (
        "solver",
        "milp_solver",
        "time_limit_s",
        "gap",
        "refine",
        "samples",
        "uncertainty",
        "risk",
        "pool",
        "pool_tolerance",
    ),
    "What is driven": (
        "scene",
        "cases",
        "speeds",
        "approaches",
        "weather",
        "force",
        "phase",
        "weights",
    ),
    "What is seen, told and braked": (
        "fusion",
        "detector",
        "vut_sensors",
        "packet_loss",
        "vam_rate",
        "n_confirmations",
        "latency_s",
        "latency_budget",
        "latency_mode",
        "deceleration_mps2",
        "build_up_s",
        "recording",
        "min_confidence",
    ),
    "The program itself": (
        "as_json",
        "quiet",
        "verbose",
        "seed",
        "workers",
        "uses_cache",
        "version",
        "_click_default_help",
    ),
}
"""Names of parameters, section by section; what is in none stands before them all."""


class SectionedCommand(click.Command):
    """A command whose options are listed in sections."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options."""
        _write_sections(self, ctx, formatter)


class SectionedGroup(click.Group):
    """A group with options of its own, listed in sections, and commands."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write commands first: whoever looks for one need not pass by the options."""
        self.format_commands(ctx, formatter)
        _write_sections(self, ctx, formatter)


def _write_sections(
    command: click.Command, ctx: click.Context, formatter: click.HelpFormatter
) -> None:
    section_of = {name: title for title, names in _SECTIONS.items() for name in names}
    sections: dict[str, list[tuple[str, str]]] = {"Options": [], **{key: [] for key in _SECTIONS}}
    for param in command.get_params(ctx):
        record = param.get_help_record(ctx)
        if record is not None:
            sections[section_of.get(str(param.name), "Options")].append(record)
    for title, records in sections.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)
