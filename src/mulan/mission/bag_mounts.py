"""Where sensors sit on their robots: the tree of ``/tf_static``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission import messages, ros_poses
from mulan.mission.bag_topics import BagTopics


@dataclass(frozen=True)
class Mounts:
    """Static transforms of a bag.

    Attributes:
        source: The bag.
        parent: Parent frame and ``T_parent_child`` of each child frame.
    """

    source: Path
    parent: dict[str, tuple[str, Float[NDArray, "4 4"]]]

    @classmethod
    def of(cls, bag: BagTopics) -> "Mounts":
        """Gather every static transform; the last one published for a frame counts.

        Raises:
            InputError: A transform is not finite or not a rotation.
        """
        parent = {}
        for message in bag.of(messages.TF_STATIC):
            for stamped in message.transforms:
                t, q = stamped.transform.translation, stamped.transform.rotation
                child = stamped.child_frame_id.lstrip("/")
                try:
                    T = ros_poses.to_matrices(np.array([[t.x, t.y, t.z]]), np.array([[q.x, q.y, q.z, q.w]]))[
                        0
                    ]
                except ValueError as error:
                    raise bag.error(
                        messages.TF_STATIC,
                        f"the transform to {child} is not rigid ({error})",
                        "publish a valid one",
                    ) from error
                parent[child] = (stamped.header.frame_id.lstrip("/"), T)
        return cls(bag.source, parent)

    def has(self, frame: str) -> bool:
        """Whether a frame is in the tree."""
        return frame in self.parent

    def T_parent_child(self, ancestor: str, frame: str) -> Float[NDArray, "4 4"]:
        """Pose of a frame in one of its ancestors, through any frames between.

        Raises:
            InputError: No chain of transforms leads from the one to the other.
        """
        T, at = np.eye(4), frame
        for _ in range(len(self.parent)):
            if at == ancestor or at not in self.parent:
                break
            at, T_up = self.parent[at]
            T = T_up @ T
        if at != ancestor:
            raise InputError(
                self.source,
                f"topic {messages.TF_STATIC}",
                f"no transform leads from {ancestor} to {frame}",
                "publish where that sensor is mounted",
            )
        return T
