"""Messages of sensors with the tick of their capture, and the protocols of messages and sensors.

A message class with images names their fields in ``IMAGES``, a stereo pair left first (see ``sensors.messages``).
"""

import inspect
from dataclasses import Field, dataclass, is_dataclass
from types import NoneType, UnionType
from typing import Any, ClassVar, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

GreyImage = NDArray[np.uint8]  # (height, width), [v, u]
ColourImage = NDArray[np.uint8]  # (height, width, 3), RGB; a renderer's may be RGBA
NearnessImage = NDArray[np.float32]  # (height, width) inverse depth along the optical axis [1/m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoFrame:
    """A stereo pair, grey. Once rectified, row v of both images sees the same epipolar line."""

    IMAGES: ClassVar[tuple[str, ...]] = ("left", "right")

    tick: int
    left: GreyImage
    right: GreyImage
    colour: ColourImage | None = None  # of the left camera, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyPose:
    """Pose of a vehicle's unit, from an exact reference unit or one like the RT3022."""

    tick: int
    X_WB: FloatArray  # (4, 4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GnssIns:
    """Position, velocity and attitude of a GNSS-aided inertial unit U; W is its local map."""

    tick: int
    p_WU: FloatArray  # (3,) [m]
    v_WU: FloatArray  # (3,) along the axes of W [m/s]
    heading: float  # of its x axis, + to the left of W's x [rad]
    pitch: float  # + nose down [rad]
    roll: float  # + left side up [rad]


@dataclass(frozen=True, slots=True, kw_only=True)
class EgoState:
    """State as perceived by the driver: pose and velocity of the tractor (frame T), articulation angles."""

    tick: int
    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    v_x: float  # [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]
    articulation: tuple[float, ...] = ()  # (N-1,) at each hitch, seen in the mirrors [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CombinationSignals:
    """Signals of a combination of N units for the steering of one of its trailers."""

    tick: int
    angles: FloatArray  # (n_steered,) encoders of that trailer's steered axles, front to rear, + left [rad]
    speed: float  # of the tractor's rear axle, from the wheel speeds of its foremost steered axle [m/s]
    steer: float  # road-wheel angle of that axle, + left [rad]
    articulation: FloatArray  # (N-1,) at each hitch: psi of the unit ahead minus psi of the unit behind [rad]
    yaw_rates: FloatArray  # (N,) gyros, tractor first [rad/s]
    lateral_acceleration: float  # accelerometer on the body above that trailer's axle group, + left [m/s2]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrailerView:
    """Stereo frame of a trailer with the signals of the combination since the view before."""

    tick: int  # at which the frame was due
    frame: StereoFrame | None  # may have an older tick; None: none arrived
    signals: tuple[CombinationSignals, ...]  # oldest first


def stereo_frame(message: object) -> StereoFrame | None:
    """The stereo frame of a message, alone or with signals; None if it has none."""
    frame = message.frame if isinstance(message, TrailerView) else message
    return frame if isinstance(frame, StereoFrame) else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverView:
    """Ground image, encoders and compass of a rover at one tick: the input of slip estimation."""

    IMAGES: ClassVar[tuple[str, ...]] = ("image",)

    tick: int
    image: GreyImage  # of the ground behind the left rear wheel
    heading: float  # of the compass, in W, wrapped [rad]
    wheel_speeds: FloatArray  # (n,) of rotation, by the encoders, in the order of the rover's file [rad/s]
    steer: FloatArray  # (n,) by the encoders, + left [rad]
    colour: ColourImage | None = None  # the image in colour, for people and videos only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverReadings:
    """Readings of a rover's encoders and compass at one tick."""

    tick: int
    heading: float  # of the compass, in W, wrapped [rad]
    wheel_speeds: FloatArray  # (n,) of rotation, in the order of the rover's file [rad/s]
    steer: FloatArray  # (n,) + left [rad]

    def seen(self, image: GreyImage) -> RoverView:
        """The readings with a ground image of the same tick."""
        return RoverView(
            tick=self.tick, image=image, heading=self.heading, wheel_speeds=self.wheel_speeds, steer=self.steer
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipReading:
    """Exact slip of a rover, as an ideal instrument would measure it."""

    tick: int
    slip_angle: float  # direction of travel of R's origin against the body's x axis, + left [rad]
    wheel_slip: float  # of the left rear wheel: direction of travel against its heading [rad]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserFix:
    """Position of the rover, measured by a laser tracker on the ground."""

    tick: int
    p_WR: FloatArray  # (3,) of R's origin [m]


class Stamped(Protocol):
    """An object that carries its time."""

    @property
    def tick(self) -> int:
        """Time stamp [ticks]."""


class Message(Stamped, Protocol):
    """A message: a frozen dataclass stamped with the tick of its capture.

    A message with images names their fields in ``IMAGES: ClassVar[tuple[str, ...]]``, a stereo pair left first. A field
    ``colour``, if there is one, is a picture for people and may be None.
    """

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


TruthT = TypeVar("TruthT", bound=Stamped, contravariant=True)
MessageT = TypeVar("MessageT", bound=Message, covariant=True)
M = TypeVar("M", bound=Message)


class Sensor(Protocol[TruthT, MessageT]):
    """Anything that turns ground truth into messages."""

    def sample(self, truth: TruthT, /) -> MessageT | None:
        """Message captured at this tick; None if none arrives."""


def message_type(sensor: Sensor[Any, M]) -> type[M]:
    """Class of a sensor's messages, read from the return annotation of its ``sample``.

    Raises:
        ValueError: one line, if there is no such annotation or it names no dataclass with a field ``tick``.
    """
    kind = type(sensor)
    try:
        annotation = get_type_hints(kind.sample).get("return")
    except NameError as error:
        raise ValueError(f"{kind.__name__}.sample: annotation cannot be resolved: {error}") from error
    classes = _classes(annotation)
    if len(classes) != 1 or not is_message(classes[0]):
        raise ValueError(
            f"{kind.__name__}.sample must be annotated with the message it returns: one dataclass with a field 'tick'"
        )
    message: type[M] = classes[0]
    return message


def check_receives(name: str, receiver: object, sensor: Any) -> None:
    """Refuse a sensor that sends other messages than the receiver's ``step(memory, message)`` is annotated for.

    What has no annotations is not checked. Either may be a class; a class of sensors names its messages in ``sends``.

    Raises:
        ValueError: one line with both classes of messages.
    """
    step = getattr(receiver if isinstance(receiver, type) else type(receiver), "step", None)
    names = [*inspect.signature(step).parameters][2:3] if step is not None else []
    try:
        wanted = [kind for name_ in names for kind in _classes(get_type_hints(step).get(name_))]
        sent = getattr(sensor, "sends", None) or message_type(sensor)
    except (NameError, ValueError):
        return
    if wanted and all(map(is_message, wanted)) and not issubclass(sent, tuple(wanted)):
        needed = " or ".join(kind.__name__ for kind in wanted)
        raise ValueError(f"{name} needs messages of type {needed}; the sensor sends {sent.__name__}")


def _classes(annotation: Any) -> list[Any]:
    """Classes of an annotation, which may be a union; without None."""
    is_union = get_origin(annotation) in (Union, UnionType)
    return [part for part in (get_args(annotation) if is_union else (annotation,)) if part is not NoneType]


def is_message(kind: object) -> bool:
    """Test whether a class is a dataclass with a field ``tick``."""
    return isinstance(kind, type) and is_dataclass(kind) and "tick" in kind.__dataclass_fields__


def image_fields(kind: type[Message]) -> tuple[str, ...]:
    """Names of the fields of a message class that hold images; empty if there are none."""
    return getattr(kind, "IMAGES", ())
