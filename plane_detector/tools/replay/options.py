# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Input and outputs of a replay."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

from plane_detector.config import Config, NodeConfig
from plane_detector.ros.outputs.topics import OUTPUTS

# Where a bag is read from and written to, and how fast, is not what is in it.
_NOT_OF_THE_CONTENT = ('source', 'target', 'figures', 'ply', 'table', 'leftover')


@dataclass(frozen=True)
class ReplayOptions:
    """
    Input and outputs of a replay.

    Attributes
    ----------
    source, target : Path
        The bag that is read, and the new one.
    config : Config
    settings : NodeConfig
    topics : mapping of str to str
        Input topics asked for; see :func:`find_camera`.
    depth_by_bag : bool
        Whether measured depth is taken where the bag has it for the image, whatever
        ``config.depth.source`` says.
    start_s, duration_s : float
        The part of the bag that is replayed, from its first message on.
    every : int
        One frame in this many is used, the first.
    outputs : tuple of str
        Names of the outputs that are written.
    copied : tuple of str or None
        Topics that are copied; an empty tuple: the inputs; None: nothing.
    storage : str
        ``mcap`` or ``sqlite3``.
    compressed : bool
    figures, ply, table : Path or None
        See :class:`ReplayFiles`.
    leftover : str
        What is done with a bag that was begun earlier and not finished: ``refuse``, ``restart``
        or ``resume``.

    """

    source: Path
    target: Path
    config: Config = field(default_factory=Config)
    settings: NodeConfig = field(default_factory=NodeConfig)
    topics: Mapping[str, str] = field(default_factory=dict)
    depth_by_bag: bool = False
    start_s: float = 0.0
    duration_s: float = float('inf')
    every: int = 1
    outputs: tuple[str, ...] = tuple(OUTPUTS)
    copied: tuple[str, ...] | None = None
    storage: str = 'mcap'
    compressed: bool = False
    figures: Path | None = None
    ply: Path | None = None
    table: Path | None = None
    leftover: str = 'refuse'

    @property
    def fingerprint(self) -> str:
        """Return a hash of the settings that decide the content of the new bag."""
        content = [(f.name, repr(getattr(self, f.name))) for f in fields(self)
                   if f.name not in _NOT_OF_THE_CONTENT]
        return hashlib.sha256(repr(content).encode()).hexdigest()[:16]
