# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Temporal filter of scale and shift: smoothing, holding without an estimate, outlier rejection.

Two estimates are compared by the change of depth between them. A small change is averaged; a large
one is ignored until several consecutive frames agree on it, which means that the scene has
changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plane_detector.config import ScaleConfig
from plane_detector.scale.methods import METHODS
from plane_detector.types import RELATIVE, ScaleEstimate

# Methods that estimate in each frame; the results of the others are used unfiltered.
MEASURED = ('depth_topic', 'camera_height', 'manhattan')


@dataclass(frozen=True)
class ScaleState:
    """The scale in use, and the state for the next frame."""

    estimate: ScaleEstimate
    outliers: tuple[ScaleEstimate, ...] = ()  # last frames that contradict it, but not each other
    missed: int = 0  # frames since the current method last succeeded
    event: str = ''  # change at this frame, for the log; empty if none
    method: str = 'auto'  # scale.method at this frame


def update_scale(state: ScaleState | None, measured: ScaleEstimate,
                 config: ScaleConfig) -> ScaleState:
    """
    Return the state after one more frame; None before the first, or to reset the filter.

    Another ``scale.method`` resets it too.
    """
    if state is None or state.method != config.method:
        return ScaleState(measured, event=f'scale: {measured}', method=config.method)
    return replace(_after(state, measured, config), method=config.method)


def _after(state: ScaleState, measured: ScaleEstimate, config: ScaleConfig) -> ScaleState:
    current = state.estimate
    if (measured.method, measured.is_metric) == (current.method, current.is_metric):
        if measured.method not in MEASURED:
            return ScaleState(measured)
        return _blend(state, _in_same_unit(measured, current), config)
    held = current.method in MEASURED and _rank(measured) > _rank(current)
    if held and measured.method in (*MEASURED, RELATIVE) and state.missed < config.hold_frames:
        event = '' if state.missed else f'scale held from {current.method}: {measured.note}'
        return ScaleState(current, (), state.missed + 1, event)
    return ScaleState(measured, event=f'scale: {measured}, no longer {current.method}')


def depth_change(estimate: ScaleEstimate, other: ScaleEstimate) -> float:
    """
    Return the largest relative change of depth between two scales, over the span of other.

    Where ``other`` was measured, its depth is positive; infinite if it is not by this one.
    """
    disparity = np.array(other.span)
    inverse = estimate.scale * disparity + estimate.shift
    other_inverse = other.scale * disparity + other.shift
    if inverse.min() <= 0:
        return np.inf
    return float(np.expm1(np.abs(np.log(other_inverse / inverse)).max()))


def _rank(estimate: ScaleEstimate) -> tuple[bool, int]:
    """Return the rank of an estimate; a smaller value is a better method."""
    order = (*METHODS, RELATIVE)
    return not estimate.is_metric, order.index(estimate.method)


def _in_same_unit(measured: ScaleEstimate, current: ScaleEstimate) -> ScaleEstimate:
    """Keep the unit of the first frame unless it is the metre: only the shift is estimated."""
    if measured.is_metric:
        return measured
    middle = measured.span[1]
    factor = ((current.scale * middle + current.shift)
              / (measured.scale * middle + measured.shift))
    if not (np.isfinite(factor) and factor > 0):
        return measured
    return replace(measured, scale=factor * measured.scale, shift=factor * measured.shift)


def _blend(state: ScaleState, measured: ScaleEstimate, config: ScaleConfig) -> ScaleState:
    current = state.estimate
    change = depth_change(current, measured)
    if change <= config.max_jump:
        keep = config.smoothing
        return ScaleState(replace(
            measured, scale=keep * current.scale + (1 - keep) * measured.scale,
            shift=keep * current.shift + (1 - keep) * measured.shift))
    why = (f'depth differs by {change:.0%}' if np.isfinite(change) else
           'with the scale in use, a part of it is behind the camera')
    agrees = state.outliers and depth_change(state.outliers[-1], measured) <= config.max_jump
    outliers = (*state.outliers, measured) if agrees else (measured,)
    if len(outliers) >= config.reset_after:
        return ScaleState(measured, event=f'scale reset, {why}: {len(outliers)} consecutive '
                                          'frames agree on a new scene')
    event = '' if agrees else f'outlier frame ignored, {why}'
    return ScaleState(current, outliers, 0, event)
