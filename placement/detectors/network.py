"""An exported neural network that looks at rendered pictures."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.errors import InputError, Unquoted

from .evidence import VRU_CLASSES, Detections, Evidence
from .onnx_model import OnnxModel, load_onnx_model, vru_boxes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NetworkDetector:
    """Detects by a network; pictures in which the VRU is too small are not shown to it.

    Attributes
    ----------
    name : str
        Name of the file.
    model : OnnxModel
        The network.
    min_box_height_px : float
        Of the visible box. [px]
    min_confidence : float
        Boxes below it do not count.
    """

    name: str
    model: OnnxModel
    min_box_height_px: float
    min_confidence: float

    @property
    def description(self) -> str:
        """When it detects."""
        return (
            f"The network {self.name} looks at rendered pictures; its boxes count from a "
            f"confidence of {self.min_confidence:g} on where they overlap the road user's visible "
            "part by more than 0.5 (intersection over union). Poses are chosen by boxes alone."
        )

    @property
    def needs_shares(self) -> bool:
        """False: it sees for itself."""
        return False

    @property
    def needs_pictures(self) -> bool:
        """True: it looks at nothing else."""
        return True

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Show each picture in which the VRU is large enough to the network.

        Raises
        ------
        InputError
            There are no pictures.
        """
        if evidence.picture is None:
            raise InputError("evidence", Unquoted("no pictures"), "pictures for the network")
        height = evidence.visible_px[:, 3] - evidence.visible_px[:, 1]
        rows: list[int] = []
        boxes: list[np.ndarray] = []
        confidence: list[np.ndarray] = []
        kinds = np.broadcast_to(evidence.vru_class, len(evidence))
        for row in np.flatnonzero(height >= max(self.min_box_height_px, 1.0e-9)).tolist():
            found = vru_boxes(self.model.detect(evidence.picture(row)))
            of_class = found.cyclists if VRU_CLASSES[kinds[row]] == "cyclist" else found.persons
            is_sure = of_class.confidence >= self.min_confidence
            boxes.append(of_class.boxes_px[is_sure])
            confidence.append(of_class.confidence[is_sure])
            rows += [row] * int(is_sure.sum())
        return Detections(
            row_index=np.array(rows, dtype=np.int64),
            boxes_px=np.concatenate([np.empty((0, 4)), *boxes]),
            confidence=np.concatenate([np.empty(0), *confidence]),
        )


def load_network_detector(
    path: Path, *, min_box_height_px: float, min_confidence: float
) -> NetworkDetector:
    """Detector from an ONNX file.

    Raises
    ------
    InputError
        The file is no detector.
    MissingExtraError
        onnxruntime is not installed.
    """
    return NetworkDetector(
        name=path.name,
        model=load_onnx_model(path),
        min_box_height_px=min_box_height_px,
        min_confidence=min_confidence,
    )
