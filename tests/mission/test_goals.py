from typing import Any

import numpy as np

from mulan.geometry import se3, so3
from mulan.mission.goals import goal_message, goals_as_json
from mulan.mission.messages import GOAL, typestore
from mulan.planning.candidates import look_at

EYE, SEEN = np.array([2.0, 1.0, 1.5]), np.array([0.0, 0.5, 0.5])


def test_a_goal_faces_what_its_camera_would_see_and_survives_the_wire():
    goal = goal_message(look_at(EYE, SEEN, np.array([0.0, 1.0, 0.0])), "alpha/odom")
    store = typestore()
    wire = store.serialize_cdr(goal, GOAL.msgtype)
    back: Any = store.deserialize_cdr(wire, GOAL.msgtype)
    turn = back.pose.orientation
    R = so3.from_quaternion(np.array([[turn.x, turn.y, turn.z, turn.w]]))[0]
    ahead = (SEEN - EYE) / np.linalg.norm(SEEN - EYE)
    np.testing.assert_allclose(R[:, 0], ahead, atol=1e-12)
    assert R[2, 2] > 0.5, "z is up"
    assert abs(R[2, 1]) < 1e-12, "y is level"
    assert back.header.frame_id == "alpha/odom"


def test_goals_are_written_by_topic_with_the_fields_of_the_message():
    T = se3.from_parts(np.eye(3), EYE)
    goals = goals_as_json({"alpha": T, "beta": T}, "alpha/odom")
    assert list(goals) == ["/alpha/goal_pose", "/beta/goal_pose"]
    assert goals["/beta/goal_pose"]["pose"]["position"] == {"x": 2.0, "y": 1.0, "z": 1.5}
    assert goals["/beta/goal_pose"]["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "alpha/odom"}
