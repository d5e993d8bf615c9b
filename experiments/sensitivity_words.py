"""Assumptions and their values in words, for tables and figures alike."""

TITLES = {
    "latency_s": "end-to-end latency",
    "n_confirmations": "frames that confirm",
    "deceleration_mps2": "deceleration",
    "packet_loss": "messages lost",
    "min_box_height_share": "detector's smallest box",
    "min_iou": "overlap (IoU) it needs",
    "yaw_deg": "all units turned",
    "pitch_deg": "all units tilted",
    "height_m": "all units lifted",
    "position_m": "all units moved ahead",
}
_PHRASES = {
    "latency_s": "an end-to-end latency of {}",
    "n_confirmations": "{} frames that confirm",
    "deceleration_mps2": "a deceleration of {}",
    "packet_loss": "{} of the messages lost",
    "min_box_height_share": "a detector whose smallest box is {} of the plan's",
    "min_iou": "a detector that needs an overlap (IoU) of {}",
    "yaw_deg": "all units turned by {}",
    "pitch_deg": "all units tilted by {}",
    "height_m": "all units lifted by {}",
    "position_m": "all units moved ahead by {}",
}
_MINUS = "\N{MINUS SIGN}"


def value_text(name: str, value: float) -> str:
    """A value of an assumption, with its unit.

    Parameters
    ----------
    name : str
        One of :data:`placement.assumptions.RANGES`.
    value : float
        In the unit that the name ends in.

    Examples
    --------
    >>> value_text("latency_s", 0.3), value_text("packet_loss", 0.05), value_text("height_m", 0.25)
    ('300 ms', '5 %', '+25 cm')
    """
    if name == "latency_s":
        return f"{1000.0 * value:g} ms"
    if name == "n_confirmations":
        return f"{value:g}"
    if name == "deceleration_mps2":
        return f"{value:g} m/s\N{SUPERSCRIPT TWO}"
    if name in ("packet_loss", "min_box_height_share"):
        return f"{100.0 * value:g} %"
    if name == "min_iou":
        return f"{value:g}"
    sign = "+" if value > 0.0 else _MINUS if value < 0.0 else ""
    if name in ("height_m", "position_m"):
        return f"{sign}{100.0 * abs(value):g} cm"
    return f"{sign}{abs(value):g}\N{DEGREE SIGN}"


def phrase(name: str, value: float) -> str:
    """An assumption with a value, as part of a sentence.

    Examples
    --------
    >>> phrase("latency_s", 0.3)
    'an end-to-end latency of 300 ms'
    """
    return _PHRASES[name].format(value_text(name, value))
