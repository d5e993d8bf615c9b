"""Image evidence by hand: what is not said is at its best."""

import numpy as np

from placement.detectors import VRU_CLASSES, Evidence


def build_evidence(
    visible_px,
    amodal_px=None,
    *,
    contrast=1.0,
    visible_share=1.0,
    inside_share=1.0,
    aspect_deg=90.0,
    vru_class="pedestrian",
    draw_index=None,
) -> Evidence:
    """One row per box; a number or a name stands for every row."""
    visible = np.array(visible_px, dtype=float).reshape(-1, 4)
    n_rows = len(visible)
    if amodal_px is None:
        amodal = visible
    else:
        amodal = np.array(amodal_px, dtype=float).reshape(-1, 4)

    def rows(value):
        return np.broadcast_to(np.array(value, dtype=float), n_rows)

    names = np.broadcast_to(np.array(vru_class), n_rows)
    return Evidence(
        visible_px=visible,
        amodal_px=np.broadcast_to(amodal, visible.shape),
        contrast=rows(contrast),
        visible_share=rows(visible_share),
        inside_share=rows(inside_share),
        aspect_deg=rows(aspect_deg),
        vru_class=np.array([VRU_CLASSES.index(name) for name in names], dtype=np.int64),
        draw_index=np.arange(n_rows) if draw_index is None else np.array(draw_index),
    )
