"""Messages of ROS 2 by the names of their fields, and topics of a bag."""

from typing import Any, Final

from offtrack.exchange.recordings.bags import humble_types
from scenarios.extras import import_extra

NANOSECONDS: Final = 1_000_000_000


class Bag:
    """Topics of a bag and their messages."""

    def __init__(self, writer: Any) -> None:
        self._writer, self._store = writer, humble_types()
        self._connections: dict[str, Any] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of a kind such as ``nav_msgs/Path``."""
        return self._store.types[kind.replace("/", "/msg/")](**fields)

    def write(self, topic: str, kind: str, stamp: int, **fields: Any) -> None:
        """Write a message of a kind."""
        message = self.make(kind, **fields)
        self.write_raw(topic, kind, stamp, self._store.serialize_cdr(message, message.__msgtype__))

    def write_raw(self, topic: str, kind: str, stamp: int, data: bytes | memoryview) -> None:
        """Write a message that is serialised already; those of ``/tf_static`` are kept for late subscribers."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic,
                kind.replace("/", "/msg/"),
                typestore=self._store,
                offered_qos_profiles=[_latched()] if topic == "/tf_static" else [],
            )
        self._writer.write(self._connections[topic], stamp, data)

    def header(self, stamp: int, frame: str) -> Any:
        """A message's header."""
        time = self.make("builtin_interfaces/Time", sec=stamp // NANOSECONDS, nanosec=stamp % NANOSECONDS)
        return self.make("std_msgs/Header", stamp=time, frame_id=frame)

    def pose(self, position: list[float], turn: list[float]) -> Any:
        """A pose by its position and its quaternion x, y, z, w."""
        point = self.make("geometry_msgs/Point", **dict(zip("xyz", position, strict=True)))
        return self.make("geometry_msgs/Pose", position=point, orientation=self.turn(turn))

    def turn(self, turn: list[float]) -> Any:
        """A quaternion x, y, z, w."""
        return self.make("geometry_msgs/Quaternion", **dict(zip("xyzw", turn, strict=True)))

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        """A vector."""
        return self.make("geometry_msgs/Vector3", x=x, y=y, z=z)

    def transform(self, stamp: int, parent: str, child: str, position: list[float], turn: list[float]) -> Any:
        """A frame in another."""
        moved = self.make("geometry_msgs/Transform", translation=self.vector(*position), rotation=self.turn(turn))
        header = self.header(stamp, parent)
        return self.make("geometry_msgs/TransformStamped", header=header, child_frame_id=child, transform=moved)


def _latched() -> Any:
    of = import_extra("export", "ROS 2 bags need", "rosbags.interfaces")
    never = of.QosTime(2147483647, 4294967295)
    reliable, latched = of.QosReliability.RELIABLE, of.QosDurability.TRANSIENT_LOCAL
    return of.Qos(of.QosHistory.KEEP_LAST, 1, reliable, latched, never, never, of.QosLiveliness.AUTOMATIC, never, False)
