"""Protocols of sensors and of the messages they send."""

from __future__ import annotations

import inspect
from dataclasses import Field, is_dataclass
from types import NoneType, UnionType
from typing import Any, ClassVar, Protocol, TypeVar, Union, get_args, get_origin, get_type_hints


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
    names: tuple[str, ...] = getattr(kind, "IMAGES", ())
    return names
