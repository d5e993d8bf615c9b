"""Runs cut to some of their frames."""

from dataclasses import replace

_PER_FRAME = (
    *("time_s", "vut_position_m", "vut_yaw_deg"),
    *("vru_position_m", "vru_yaw_deg", "vru_shape"),
)


def cut_run(run, frames, **changed):
    """A run with these of its frames alone, a slice; other fields may be changed,
    too.
    """
    return replace(
        run,
        **{name: getattr(run, name)[frames] for name in _PER_FRAME},
        **changed,
    )
