"""ROS messages to ours and back.  The types used here have not changed over the distributions of ROS 1 or of ROS 2.

Ground truth that also knows velocity and biases is spread over three topics, because no standard message holds them
all without a change of frame (which would cost the last bits):
`T` PoseStamped, `T/velocity` TwistStamped whose linear part is v_w_b in the world frame, and `T/bias` TwistStamped
whose angular part is b_g (rad/s) and whose linear part is b_a (m/s^2).
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from ..errors import RecordingError
from . import images
from .messages import GpsMessage, ImageMessage, ImuMessage, TruthMessage
from .recording import Role

VELOCITY, BIAS = "/velocity", "/bias"

ROLES: dict[str, Role] = {
    "sensor_msgs/msg/Image": "image",
    "sensor_msgs/msg/CompressedImage": "image",
    "sensor_msgs/msg/Imu": "imu",
    "sensor_msgs/msg/NavSatFix": "gps",
    "geometry_msgs/msg/PoseStamped": "truth",
    "nav_msgs/msg/Odometry": "truth",
    "geometry_msgs/msg/TransformStamped": "truth",
    "geometry_msgs/msg/PointStamped": "truth",
}
STAMPED = {*ROLES, "geometry_msgs/msg/TwistStamped"}


class Codec:
    """Bytes to messages and back for one generation of ROS."""

    def __init__(self, generation: int) -> None:
        self.generation = generation
        self.store: Typestore = get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.ROS2_HUMBLE)
        self.decode: Callable[..., Any] = self.store.deserialize_ros1 if generation == 1 else self.store.deserialize_cdr

    def stamp_ns(self, raw: bytes | memoryview) -> int:
        """The header's stamp, without decoding the message: after `seq` in ROS 1, after the CDR header in ROS 2."""
        order = ">" if self.generation == 2 and raw[1] & 1 == 0 else "<"
        seconds, nanoseconds = struct.unpack_from(f"{order}{'I' if self.generation == 1 else 'i'}I", raw, 4)
        return int(seconds) * 10**9 + int(nanoseconds)

    def encode(self, message: Any) -> bytes | memoryview:
        if self.generation == 1:
            return self.store.serialize_ros1(message, message.__msgtype__)
        return self.store.serialize_cdr(message, message.__msgtype__)

    def make(self, msgtype: str, t_ns: int, frame_id: str, **fields: Any) -> Any:
        """A stamped message of this generation."""
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        sequence = {"seq": 0} if self.generation == 1 else {}
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id, **sequence)
        return types[msgtype](header=header, **fields)


def imu(message: Any, t_ns: int, topic: str) -> ImuMessage:
    return ImuMessage(t_ns, topic, _xyz(message.angular_velocity), _xyz(message.linear_acceleration))


def gps(message: Any, t_ns: int, topic: str) -> GpsMessage:
    covariance = np.array(message.position_covariance, float).reshape(3, 3)
    status = int(message.status.status)
    return GpsMessage(t_ns, topic, message.latitude, message.longitude, message.altitude, covariance, status)


def truth(message: Any, t_ns: int, topic: str) -> TruthMessage:
    """Pose from PoseStamped, Odometry (whose twist is in the child frame), TransformStamped or PointStamped."""
    kind = message.__msgtype__.rpartition("/")[2]
    if kind == "PointStamped":
        return TruthMessage(t_ns, topic, _xyz(message.point), np.full(4, np.nan))
    if kind == "TransformStamped":
        return TruthMessage(t_ns, topic, _xyz(message.transform.translation), _wxyz(message.transform.rotation))
    if kind == "PoseStamped":
        return TruthMessage(t_ns, topic, _xyz(message.pose.position), _wxyz(message.pose.orientation))
    from ..geometry import so3

    p, q = _xyz(message.pose.pose.position), _wxyz(message.pose.pose.orientation)
    v = _xyz(message.twist.twist.linear)
    in_child_frame = message.child_frame_id not in ("", message.header.frame_id)
    return TruthMessage(t_ns, topic, p, q, so3.rotate(q, v) if in_child_frame else v)


def image(message: Any, t_ns: int, topic: str, source: str) -> ImageMessage:
    """Encoded bytes as they are; raw pixels as an array of the encoding's shape and type."""
    if hasattr(message, "format"):
        data = message.data.tobytes()
        return ImageMessage(t_ns, topic, images.sniff(data) or message.format, data)
    channels = images.CHANNELS.get(message.encoding)
    if channels is None:
        raise RecordingError(
            f"{source}: the image of {topic} at {t_ns} ns has encoding {message.encoding!r}; "
            f"expected one of {', '.join(images.CHANNELS)}"
        )
    width = images.depth_bytes(message.encoding)
    row = message.width * channels * width
    if message.step < row or len(message.data) < message.step * message.height or not row * message.height:
        raise RecordingError(
            f"{source}: the image of {topic} at {t_ns} ns cannot be read: {len(message.data)} bytes for "
            f"{message.width}x{message.height} {message.encoding} in rows of {message.step}"
        )
    rows = message.data[: message.step * message.height].reshape(message.height, message.step)[:, :row]
    kind = {1: "u1", 2: "u2", 4: "f4"}[width]
    dtype = np.dtype(f"{'>' if message.is_bigendian else '<'}{kind}")
    pixels = np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    return ImageMessage(
        t_ns,
        topic,
        message.encoding,
        pixels if channels == 1 else pixels.reshape(message.height, message.width, channels),
    )


def _xyz(v: Any) -> np.ndarray:
    return np.array([v.x, v.y, v.z], float)


def _wxyz(q: Any) -> np.ndarray:
    """NaN for the all-zero quaternion that publishers without orientation send."""
    wxyz = np.array([q.w, q.x, q.y, q.z], float)
    return wxyz if np.any(wxyz) else np.full(4, np.nan)
