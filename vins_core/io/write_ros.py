"""Writers of ROS 1 bags and ROS 2 bags (sqlite3 or mcap)."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from ..errors import OutputError
from .messages import GpsMessage, ImageMessage, ImuMessage, Message, TruthMessage
from .ros_messages import BIAS, VELOCITY, Codec

METADATA_VERSION: Literal[8] = 8  # the newest that Humble still reads


class _RosWriter:
    """Messages to connections.  A message's record time is its stamp, or 1 ns after its topic's last one."""

    def __init__(self, writer: Any, generation: int) -> None:
        self._writer = writer
        self._codec = Codec(generation)
        self._connections: dict[str, Connection] = {}
        self._record_ns: dict[str, int] = {}

    def write(self, message: Message) -> None:
        limit_s = 2**32 if self._codec.generation == 1 else 2**31
        if not 0 <= message.t_ns < limit_s * 10**9:
            raise OutputError(
                f"{self._writer.path}: {message.topic} has the stamp {message.t_ns} ns, which ROS cannot express "
                f"(0 to {limit_s} s); convert to asl instead"
            )
        match message:
            case ImageMessage():
                self._image(message)
            case ImuMessage():
                self._imu(message)
            case TruthMessage():
                self._truth(message)
            case GpsMessage():
                self._gps(message)

    def close(self) -> None:
        self._writer.close()

    def abort(self) -> None:
        """Stop and remove what was written."""
        self._writer.abort()
        path = self._writer.path
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)

    def _put(self, topic: str, msgtype: str, t_ns: int, frame_id: str, **fields: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=self._codec.store)
        record_ns = max(t_ns, self._record_ns.get(topic, -1) + 1)
        self._record_ns[topic] = record_ns
        message = self._codec.make(msgtype, t_ns, frame_id, **fields)
        self._writer.write(self._connections[topic], record_ns, self._codec.encode(message))

    def _type(self, name: str, *values: Any) -> Any:
        return self._codec.store.types[f"geometry_msgs/msg/{name}"](*values)

    def _vector(self, name: str, values: np.ndarray) -> Any:
        return self._type(name, *(float(v) for v in values))

    def _quaternion(self, wxyz: np.ndarray) -> Any:
        w, x, y, z = (float(v) for v in wxyz)
        return self._type("Quaternion", x, y, z, w)

    def _image(self, m: ImageMessage) -> None:
        if isinstance(m.data, bytes):
            topic = m.topic if m.topic.endswith("/compressed") else f"{m.topic}/compressed"
            data = np.frombuffer(m.data, np.uint8)
            self._put(topic, "sensor_msgs/msg/CompressedImage", m.t_ns, "camera", format=m.format, data=data)
            return
        rows = np.ascontiguousarray(m.data, m.data.dtype.newbyteorder("<"))
        self._put(
            m.topic,
            "sensor_msgs/msg/Image",
            m.t_ns,
            "camera",
            height=rows.shape[0],
            width=rows.shape[1],
            encoding=m.format,
            is_bigendian=0,
            step=rows.nbytes // rows.shape[0],
            data=rows.reshape(-1).view(np.uint8),
        )

    def _imu(self, m: ImuMessage) -> None:
        unknown = np.array([-1.0, *[0.0] * 8])  # ROS: a first covariance of -1 means "not measured"
        self._put(
            m.topic,
            "sensor_msgs/msg/Imu",
            m.t_ns,
            "imu",
            orientation=self._quaternion(np.array([1.0, 0.0, 0.0, 0.0])),
            orientation_covariance=unknown,
            angular_velocity=self._vector("Vector3", m.gyro_rad_s),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=self._vector("Vector3", m.accel_m_s2),
            linear_acceleration_covariance=np.zeros(9),
        )

    def _truth(self, m: TruthMessage) -> None:
        if m.v_w_b is not None:
            self._twist(m.topic + VELOCITY, m.t_ns, "world", np.zeros(3), m.v_w_b)
        if m.b_g is not None and m.b_a is not None:
            self._twist(m.topic + BIAS, m.t_ns, "imu", m.b_g, m.b_a)
        position = self._vector("Point", m.p_w_b)
        if np.isnan(m.q_w_b).any():
            self._put(m.topic, "geometry_msgs/msg/PointStamped", m.t_ns, "world", point=position)
        else:
            pose = self._type("Pose", position, self._quaternion(m.q_w_b))
            self._put(m.topic, "geometry_msgs/msg/PoseStamped", m.t_ns, "world", pose=pose)

    def _twist(self, topic: str, t_ns: int, frame_id: str, angular: np.ndarray, linear: np.ndarray) -> None:
        twist = self._type("Twist", self._vector("Vector3", linear), self._vector("Vector3", angular))
        self._put(topic, "geometry_msgs/msg/TwistStamped", t_ns, frame_id, twist=twist)

    def _gps(self, m: GpsMessage) -> None:
        status = self._codec.store.types["sensor_msgs/msg/NavSatStatus"](status=m.status, service=1)
        self._put(
            m.topic,
            "sensor_msgs/msg/NavSatFix",
            m.t_ns,
            "gps",
            status=status,
            latitude=m.latitude_deg,
            longitude=m.longitude_deg,
            altitude=m.altitude_m,
            position_covariance=np.ascontiguousarray(m.covariance_enu_m2, float).reshape(9),
            position_covariance_type=3,
        )


class Ros1Writer(_RosWriter):
    def __init__(self, out: Path) -> None:
        writer = Writer1(out)
        writer.open()
        super().__init__(writer, 1)


class Ros2Writer(_RosWriter):
    """A bag folder, or the storage file alone when the name says so."""

    def __init__(self, out: Path, storage: Literal["sqlite3", "mcap"]) -> None:
        self._out = out
        self._bare = out.suffix == {"sqlite3": ".db3", "mcap": ".mcap"}[storage]
        self._folder = out.with_name(out.name + ".part") if self._bare else out
        if self._folder.exists():
            raise OutputError(f"{self._folder}: exists already and is not overwritten; remove it")
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(self._folder, version=METADATA_VERSION, storage_plugin=plugin)
        writer.open()
        super().__init__(writer, 2)

    def close(self) -> None:
        super().close()
        if self._bare:
            next(self._folder.glob(f"*{self._out.suffix}")).rename(self._out)
            shutil.rmtree(self._folder)
