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

# Paths and the handling of unfinished bags do not affect the content.
_NOT_OF_THE_CONTENT = ('source', 'target', 'figures', 'ply', 'table', 'leftover')


@dataclass(frozen=True)
class ReplayOptions:
    """
    Input and outputs of a replay.

    Attributes
    ----------
    source, target : Path
        The input bag and the new bag.
    config : Config
    settings : NodeConfig
    topics : mapping of str to str
        Requested input topics; see :func:`find_camera`.
    depth_by_bag : bool
        Whether to use measured depth if the bag has it for the image, whatever
        ``config.depth.source`` is.
    start_s, duration_s : float
        Part of the bag to replay, relative to its first message.
    every : int
        One frame in this many is processed, starting with the first.
    outputs : tuple of str
        Names of the outputs to write.
    copied : tuple of str or None
        Topics to copy; an empty tuple: the inputs; None: nothing.
    storage : str
        ``mcap`` or ``sqlite3``.
    compressed : bool
    figures, ply, table : Path or None
        See :class:`ReplayFiles`.
    leftover : str
        What to do with an unfinished bag of an earlier run: ``refuse``, ``restart`` or
        ``resume``.

    Examples
    --------
    >>> options = ReplayOptions(Path('walk'), Path('planes/walk'), depth_by_bag=True, every=2)
    >>> options.target.as_posix(), options.storage
    ('planes/walk', 'mcap')

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
        """Return a hash of the settings that determine the content of the new bag."""
        content = [(f.name, repr(getattr(self, f.name))) for f in fields(self)
                   if f.name not in _NOT_OF_THE_CONTENT]
        return hashlib.sha256(repr(content).encode()).hexdigest()[:16]
