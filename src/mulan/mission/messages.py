"""The topics of a mission bag and their ROS 2 message types, with the three messages ROS lacks."""

from dataclasses import dataclass
from functools import cache

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

CSI_DEFINITION = """\
# Channel state of one packet received from one peer.
std_msgs/Header header     # reception time on the receiver's clock
string peer                # name of the sender
uint32 frame_counter       # shared by a packet and its reply; pairs the two directions
uint8 antennas
float64[] subcarrier_hz    # absolute frequency of each subcarrier
float32[] real             # row-major, antennas x subcarriers
float32[] imag
"""

RANGE_DEFINITION = """\
# One UWB range to one peer.
std_msgs/Header header     # time on this robot's clock
string peer                # name of the other robot
float64 range_m            # antenna to antenna
float64 sigma_m            # standard deviation
"""

REQUEST_DEFINITION = """\
# The base station asks a robot to move its antenna on a short loop while others answer its packets.
std_msgs/Header header     # when it was asked, on the base station's clock; frame: the robot's odometry
string[] peers             # who should answer; nobody: nothing needs to be measured for now
"""

CSI_TYPE = "mulan_msgs/msg/Csi"
RANGE_TYPE = "mulan_msgs/msg/Range"
REQUEST_TYPE = "mulan_msgs/msg/MeasurementRequest"


@dataclass(frozen=True)
class Topic:
    """One channel every robot has under its own namespace.

    Attributes:
        suffix: What follows ``/<robot>/``.
        msgtype: Its ROS 2 type.
    """

    suffix: str
    msgtype: str

    def of(self, robot: str) -> str:
        """Full topic name for one robot."""
        return f"/{robot}/{self.suffix}"


IMAGE = Topic("camera/image/compressed", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO = Topic("camera/camera_info", "sensor_msgs/msg/CameraInfo")
ODOMETRY = Topic("odom", "nav_msgs/msg/Odometry")
CSI = Topic("csi", CSI_TYPE)
RANGE = Topic("range", RANGE_TYPE)
GROUND_TRUTH = Topic("ground_truth", "geometry_msgs/msg/PoseStamped")
GOAL = Topic("goal_pose", "geometry_msgs/msg/PoseStamped")  # sent to a robot, not recorded by it
POSE = Topic("pose", "geometry_msgs/msg/PoseWithCovarianceStamped")  # body in world, from the base station
REQUEST = Topic("measurement_request", REQUEST_TYPE)  # sent to a robot
ROBOT_TOPICS = (IMAGE, CAMERA_INFO, ODOMETRY, CSI, RANGE, GROUND_TRUTH)

HELD_OUT = "held_out"  # the namespace of test views; no robot may have this name
TF_STATIC = "/tf_static"
TF_STATIC_TYPE = "tf2_msgs/msg/TFMessage"
ROBOTS = "/robots"  # names in order, separated by spaces: the first is the anchor
ROBOTS_TYPE = "std_msgs/msg/String"


@dataclass(frozen=True)
class RobotFrames:
    """Names of one robot's coordinate frames."""

    robot: str

    @property
    def odom(self) -> str:
        """Start frame of the odometry."""
        return f"{self.robot}/odom"

    @property
    def body(self) -> str:
        """The robot's body."""
        return f"{self.robot}/base_link"

    @property
    def camera_optical(self) -> str:
        """The camera on REP-103 optical axes (x right, y down, z forward)."""
        return f"{self.robot}/camera_optical"

    @property
    def wifi_antenna(self) -> str:
        """Phase centre of the WiFi antenna, on body axes."""
        return f"{self.robot}/wifi_antenna"

    @property
    def uwb_antenna(self) -> str:
        """Phase centre of the UWB antenna, on body axes."""
        return f"{self.robot}/uwb_antenna"


@cache
def typestore() -> Typestore:
    """The ROS 2 Jazzy message types together with ours."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(CSI_DEFINITION, CSI_TYPE))
    store.register(get_types_from_msg(RANGE_DEFINITION, RANGE_TYPE))
    store.register(get_types_from_msg(REQUEST_DEFINITION, REQUEST_TYPE))
    return store
