"""Writer of MCAP files: encodes messages, plain dicts, by rosbags.

rosbags is an optional dependency, imported on first use.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from hplan.base.files import replacing
from hplan.base.lazy_import import extra
from hplan.errors import InputError


class Message(NamedTuple):
    """A message on a topic.

    Attributes:
        topic: Name of the topic.
        time_ns: Time of sending [ns].
        content: Fields of the message; omitted fields are zero or empty.
    """

    topic: str
    time_ns: int
    content: Mapping[str, Any]


def import_rosbags() -> tuple[ModuleType, ModuleType, ModuleType]:
    """Import the modules `rosbags.interfaces`, `rosbags.rosbag2` and `rosbags.typesys`.

    Raises:
        InputError: rosbags is not installed.
    """
    with extra("ros", "an MCAP file needs rosbags"):
        import rosbags.interfaces
        import rosbags.rosbag2
        import rosbags.typesys
    return rosbags.interfaces, rosbags.rosbag2, rosbags.typesys


def write_bag(path: Path, topics: Mapping[str, tuple[str, int]], messages: Iterable[Message]) -> Path:
    """Write an MCAP file, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        topics: For each topic its message type, and the number of messages kept for late subscribers (transient local
            durability; 0 for volatile).
        messages: The messages, in order of time.

    Returns:
        The path of the file.

    Raises:
        InputError: rosbags is not installed, or a message has a field that its type lacks.
        OutputError: The file cannot be written.
    """
    interfaces, bags, typesys = import_rosbags()
    # rosbags writes a folder that holds a file of the folder's name.
    with replacing(path) as new, tempfile.TemporaryDirectory(dir=new.parent, prefix=".hplan-") as folder:
        store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        encoder = _Encoder(store)
        bag = Path(folder, "motion")
        with bags.Writer(bag, version=9, storage_plugin=bags.StoragePlugin.MCAP) as writer:
            open_topics = {
                topic: (
                    kind,
                    writer.add_connection(
                        topic, kind, typestore=store, offered_qos_profiles=[_offer(interfaces, kept)]
                    ),
                )
                for topic, (kind, kept) in topics.items()
            }
            for message in messages:
                kind, connection = open_topics[message.topic]
                writer.write(
                    connection, message.time_ns, store.serialize_cdr(encoder.message(kind, message.content), kind)
                )
        (written,) = bag.glob("*.mcap")
        written.replace(new)
    return path


def _offer(interfaces: ModuleType, kept: int) -> Any:
    """Quality of service of a reliable topic.

    It keeps `kept` messages for late subscribers (transient local durability), or is volatile if that is 0.
    """
    durability = interfaces.QosDurability
    never = interfaces.QosTime(2147483647, 4294967295)
    return interfaces.Qos(
        history=interfaces.QosHistory.KEEP_LAST,
        depth=kept or 10,
        reliability=interfaces.QosReliability.RELIABLE,
        durability=durability.TRANSIENT_LOCAL if kept else durability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=interfaces.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )


class _Encoder:
    """Converts dicts to the message objects that rosbags encodes."""

    def __init__(self, store: Any) -> None:
        self._store = store

    def message(self, kind: str, content: Mapping[str, Any]) -> Any:
        """Convert a dict to a message object of type `kind`.

        Raises:
            InputError: The dict has a field that the type lacks.
        """
        fields = dict(self._store.fielddefs[kind][1])
        unknown = content.keys() - fields.keys()
        if unknown:
            raise InputError(f"{kind} has no field {sorted(unknown)[0]!r}", kind=kind)
        values = {name: self._value(field, content.get(name)) for name, field in fields.items()}
        return self._store.types[kind](**values)

    def _value(self, field: Any, value: Any) -> Any:
        """Convert the value of a field; None gives zero or empty."""
        node, what = field
        if node.name == "NAME":
            return self.message(what, {} if value is None else value)
        if node.name == "BASE":
            return value if value is not None else "" if what[0] == "string" else np.dtype(what[0]).type(0).item()
        (inner, kind), _ = what
        items = [] if value is None else value
        if inner.name == "NAME":
            return [self.message(kind, item) for item in items]
        return list(items) if kind[0] == "string" else np.array(items, dtype=kind[0])
