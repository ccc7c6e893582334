# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""The work of an earlier run, read from its unfinished bag."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray

from plane_detector.ros.diagnostics import HARDWARE_ID
from plane_detector.tools.replay.bag_reader import BagError, BagReader, Recorded, to_message
from plane_detector.tools.replay.bag_writer import BagWriter
from plane_detector.tools.replay.tally import DIAGNOSTICS_TOPIC, FRAME_KEY, REPLAY_NAME, Tally


@dataclass(frozen=True)
class Earlier:
    """
    The work of an earlier run.

    Attributes
    ----------
    bag : Path or None
        Its frames; None if there are none.
    next_index : int
        Number of the first unprocessed frame.
    facts : mapping of str to str
        From the diagnostics of the last processed frame.

    """

    bag: Path | None = None
    next_index: int = 0
    facts: dict[str, str] = field(default_factory=dict)


def read_earlier(path: Path | None) -> Earlier:
    """Return the work of an earlier run at a path, which may be none."""
    if path is None:
        return Earlier()
    facts: dict[str, str] = {}
    with BagReader(path) as bag:
        if DIAGNOSTICS_TOPIC in {topic.name for topic in bag.topics}:
            for recorded in bag.read([DIAGNOSTICS_TOPIC]):
                facts = _own_facts(recorded) or facts
    return Earlier(path, int(facts[FRAME_KEY]) + 1, facts) if facts else Earlier()


def copy_earlier(earlier: Earlier, writer: BagWriter, tally: Tally) -> Counter[str]:
    """
    Write the messages of an earlier run, and count them.

    Returns
    -------
    Counter of str
        Number of messages of each topic that are copies of the input, not results.

    Raises
    ------
    BagError
        It has topics that the new bag does not have.

    """
    copies: Counter[str] = Counter()
    if earlier.bag is None:
        return copies
    tally.resumed_at = earlier.next_index
    tally.processed = int(earlier.facts['frames_processed'])
    tally.skipped = int(earlier.facts['frames_skipped'])
    tally.planes = int(earlier.facts['planes_in_all'])
    with BagReader(earlier.bag) as bag:
        names = [topic.name for topic in bag.topics]
        if unknown := [name for name in names if name not in writer.topics]:
            raise BagError(f'{earlier.bag} cannot be continued: {", ".join(unknown)} would not '
                           'be in the new bag. Give the same options, or start again')
        for recorded in bag.read(names):
            own = recorded.topic == DIAGNOSTICS_TOPIC and bool(_own_facts(recorded))
            copies[recorded.topic] += not own
            writer.copy(recorded)
            writer.end_frame()
    return copies


def _own_facts(recorded: Recorded) -> dict[str, str]:
    """Return keys and values of a replay's diagnostics; empty for those of other programs."""
    (status, *_) = to_message(recorded, DiagnosticArray).status or [None]
    if status is None or (status.hardware_id, status.name) != (HARDWARE_ID, REPLAY_NAME):
        return {}
    return {pair.key: pair.value for pair in status.values}
