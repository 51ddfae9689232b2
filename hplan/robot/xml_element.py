"""Elements of robot files, with their lines."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping


class Element(ET.Element):
    """XML element with its line number (0 if not from a file).

    The root has the encoding that the file declares. If it was made from another format, `is_made` is true, and
    `assumed` has the limits that the format lacks, by name of the joint, and `ignored` tells what is not taken over.
    """

    line = 0
    encoding = "utf-8"
    is_made = False
    assumed: Mapping[str, Collection[str]] = {}
    ignored: tuple[str, ...] = ()
