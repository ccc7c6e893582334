# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Drawings of depth and planes. Labels are those of the messages: 0 means no plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from plane_detector._runtime.compilation import kernel
from plane_detector.geometry.disparity import valid_depth
from plane_detector.types import PlaneClass

# Neighbouring colours in the list, used for the largest planes, differ most.
PALETTE = np.array(
    [
        (230, 25, 75), (60, 180, 75), (0, 130, 200), (255, 225, 25), (145, 30, 180),
        (70, 240, 240), (245, 130, 48), (240, 50, 230), (210, 245, 60), (0, 128, 128),
        (250, 160, 200), (170, 110, 40), (220, 190, 255), (128, 0, 0), (170, 255, 195),
        (0, 0, 160), (250, 205, 155), (100, 130, 0), (110, 110, 255), (120, 200, 255),
    ],
    dtype=np.uint8,
)
# The colours of planes of unknown class, which look like neither floors nor walls: the reds.
_OF_UNKNOWN_CLASS = PALETTE[PALETTE.argmax(axis=1) == 0]
# The colour of each class, with its name.
CLASS_COLOURS = {
    PlaneClass.FLOOR: ('green', (40, 175, 75)), PlaneClass.RAMP: ('light green', (150, 205, 60)),
    PlaneClass.WALL: ('blue', (30, 110, 225)), PlaneClass.CEILING: ('grey', (160, 168, 176)),
    PlaneClass.OTHER_HORIZONTAL: ('yellow-brown', (205, 155, 45)),
    PlaneClass.STEP: ('orange-brown', (190, 100, 30)),
    PlaneClass.OTHER: ('grey-violet', (140, 115, 165)),
}
# Shares of white that are mixed into the colour of a class, by label; below 0: of black.
_DARKEST, _LIGHTEST = -0.35, 0.4
_GOLDEN_RATIO = 0.618034  # its multiples are spread evenly, however many labels there are
_COLOUR_SHARE = 0.55
_FARTHEST_INDEX = 20  # of the colour map; lower ones are too close to the black of invalid depth
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_TITLE_SCALE, _TITLE_HEIGHT_PX = 0.6, 36
_TEXT_HALF_HEIGHT = 0.012  # of a number, as a share of the image's height
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)


def label_colours(labels: np.ndarray) -> np.ndarray:
    """
    Return the colour of each label; the same label has the same colour in every image.

    Parameters
    ----------
    labels : (...) integer
        Above 0; the palette repeats after its last colour.

    Returns
    -------
    (..., 3) uint8
        RGB.

    Examples
    --------
    >>> bool((label_colours(np.array([3])) == label_colours(np.array([3 + len(PALETTE)]))).all())
    True

    """
    return PALETTE[(np.asarray(labels).astype(np.int64) - 1) % len(PALETTE)]


def plane_colours(labels: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """
    Return the colour of each plane: the hue shows the class, the lightness the label.

    Parameters
    ----------
    labels : (K,) integer
        Above 0.
    classes : (K,) integer
        Values of :class:`~plane_detector.types.PlaneClass`.

    Returns
    -------
    (K, 3) uint8
        RGB.

    Examples
    --------
    >>> red, green, blue = plane_colours(np.array([7]), np.array([PlaneClass.FLOOR]))[0].tolist()
    >>> green > red and green > blue
    True

    """
    colours = _OF_UNKNOWN_CLASS[np.asarray(labels) % len(_OF_UNKNOWN_CLASS)].astype(float)
    for kind, (_, colour) in CLASS_COLOURS.items():
        colours[np.asarray(classes) == kind] = colour
    light = _DARKEST + (_LIGHTEST - _DARKEST) * (np.asarray(labels) * _GOLDEN_RATIO % 1)
    light = np.where(np.isin(classes, list(CLASS_COLOURS)), light, 0.0)[:, None]
    return np.rint(colours + abs(light) * (np.where(light > 0, 255, 0) - colours)).astype(np.uint8)


def colours_by_label(labels: np.ndarray, classes: np.ndarray, last: int) -> np.ndarray:
    """
    Return the colours of labels 0 to ``last``, (last + 1, 3) uint8: of planes and of the others.

    Parameters are those of :func:`plane_colours`; all other labels, as of shapes, have the colours
    of :func:`label_colours`.
    """
    colours = label_colours(np.arange(last + 1))
    colours[labels] = plane_colours(labels, classes)
    return colours


def tint(rgb: np.ndarray, labels: np.ndarray, colours: np.ndarray | None = None,
         share: float = _COLOUR_SHARE) -> np.ndarray:
    """
    Return the image with its planes coloured.

    Parameters
    ----------
    rgb : (H, W, 3) uint8
        The image; it is not changed.
    labels : (H, W) integer
        Label of each pixel, 0 for no plane.
    colours : (N, 3) uint8, optional
        Of labels 0 to N - 1, RGB; default: the palette.
    share : float
        Share of the plane's colour; the rest is the colour of the image.

    Returns
    -------
    (H, W, 3) uint8
        RGB.

    Raises
    ------
    ValueError
        Image and labels differ in size, or ``colours`` has another type, or no colour for a label
        above 0.

    """
    if rgb.shape[:2] != labels.shape:
        raise ValueError(f'the labels are {labels.shape}, the image {rgb.shape[:2]}')
    colours = np.vstack([PALETTE[:1], PALETTE]) if colours is None else np.asarray(colours)
    if colours.dtype != np.uint8 or colours.shape != (len(colours), 3) or (
            len(colours) < 2 and labels.max(initial=0) > 0):
        raise ValueError('colours must be (N, 3) uint8, of labels 0 to N - 1, with more than that '
                         f'of label 0, not {colours.shape} {colours.dtype}: see colours_by_label')
    return _tinted(np.ascontiguousarray(rgb), np.ascontiguousarray(labels, np.int32),
                   np.ascontiguousarray(colours[1:]), share)


@kernel("uint8[:, :, ::1](Array(uint8, 3, 'C', readonly=True), "
        "Array(int32, 2, 'C', readonly=True), "
        "Array(uint8, 2, 'C', readonly=True), float64)")
def _tinted(rgb, labels, colours, share):
    """Return the image with label k mixed with colour k - 1; the colours repeat."""
    result, count, of_colour = np.empty(rgb.shape, np.uint8), len(colours), round(256 * share)
    # Of no label and of each colour: what is added, and to how many 256ths of the image.
    mix = np.zeros((count + 1, 4), np.uint32)
    mix[0, 3] = 256
    for k in range(count):
        mix[k + 1, 3] = 256 - of_colour
        for channel in range(3):
            mix[k + 1, channel] = 128 + of_colour * colours[k, channel]
    label, red, green, blue, left = 0, mix[0, 0], mix[0, 1], mix[0, 2], mix[0, 3]
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            if labels[v, u] != label:
                label = labels[v, u]
                k = max(label, 0) if label <= count else (label - 1) % count + 1
                red, green, blue, left = mix[k, 0], mix[k, 1], mix[k, 2], mix[k, 3]
            result[v, u, 0] = (left * rgb[v, u, 0] + red) >> np.uint32(8)
            result[v, u, 1] = (left * rgb[v, u, 1] + green) >> np.uint32(8)
            result[v, u, 2] = (left * rgb[v, u, 2] + blue) >> np.uint32(8)
    return result


def overlay(rgb: np.ndarray, labels: np.ndarray, colours: np.ndarray | None = None,
            places: Mapping[int, LabelPlace] | None = None) -> np.ndarray:
    """
    Return the image with its planes coloured, outlined and numbered.

    Parameters are those of :func:`tint`. ``places`` avoids computing
    :func:`label_places` again.

    Examples
    --------
    >>> drawn = overlay(np.full((40, 60, 3), 99, np.uint8), np.ones((40, 60), int))
    >>> drawn.shape, drawn.dtype.name, bool((drawn != 99).any())
    ((40, 60, 3), 'uint8', True)

    """
    result = tint(rgb, labels, colours)
    _draw_outlines(result, labels)
    draw_numbers(result, label_places(labels) if places is None else places)
    return result


class LabelPlace(NamedTuple):
    """A pixel, and its distance from the border of its region."""

    row: int
    column: int
    half_width_px: float


def label_places(labels: np.ndarray) -> dict[int, LabelPlace]:
    """
    Return the pixel at which the region of each label is widest, to write its number there.

    Parameters
    ----------
    labels : (H, W) integer
        0 for no region. Only every fourth row and column is used: small regions may be missing.

    Examples
    --------
    >>> place = label_places(np.pad(np.ones((5, 5), int), 1))[1]
    >>> place.row, place.column
    (2, 2)

    """
    step = 4 if min(labels.shape) >= 64 else 1  # for speed
    small = labels[::step, ::step].astype(np.int32)
    inside = np.pad((~label_edges(small)).astype(np.uint8), 1)
    half_width = cv2.distanceTransform(inside, cv2.DIST_L2, 3)
    pixels, half_widths = _widest(small, half_width, int(small.max(initial=0)) + 1)
    found = np.flatnonzero(pixels >= 0)
    rows, columns = np.divmod(pixels[found], small.shape[1])
    places = np.stack([rows, columns, half_widths[found]]) * step
    return {label: LabelPlace(int(row), int(column), half_width_px) for label, row, column,
            half_width_px in zip(found.tolist(), *places.tolist(), strict=True)}


@kernel('Tuple((int64[::1], float32[::1]))(int32[:, ::1], float32[:, ::1], int64)', is_short=True)
def _widest(labels, half_width, count):
    """Return the pixel, row by row, of each label's largest value, -1 without one, and that."""
    pixels, largest = np.full(count, -1, np.int64), np.full(count, -1, np.float32)
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            k = labels[v, u]
            if k > 0 and half_width[v + 1, u + 1] > largest[k]:
                pixels[k], largest[k] = v * labels.shape[1] + u, half_width[v + 1, u + 1]
    return pixels, largest


def label_edges(labels: np.ndarray) -> np.ndarray:
    """Return the pixels whose right or lower neighbour has another label, (H, W) bool."""
    edge = np.zeros(labels.shape, bool)
    edge[:, :-1] = labels[:, :-1] != labels[:, 1:]
    edge[:-1] |= labels[:-1] != labels[1:]
    return edge


def colour_depth(depth_m: np.ndarray) -> np.ndarray:
    """
    Return depth as colours, near red and far blue; RGB (H, W, 3) uint8, black where invalid.

    The scale is logarithmic between the 1st and the 99th percentile, so that streets and desks
    alike use the full range of colours.

    Examples
    --------
    >>> near, far, invalid = colour_depth(np.array([[1.0, 5.0, np.nan]]))[0].astype(int)
    >>> bool(near[0] > near[2]), bool(far[2] > far[0]), invalid.tolist()
    (True, True, [0, 0, 0])

    """
    valid = valid_depth(depth_m)
    if not valid.any():
        return np.zeros((*depth_m.shape, 3), np.uint8)
    near_m, far_m = depth_range(depth_m)
    log_depth = np.log(np.where(valid, depth_m, far_m))
    span = max(np.log(far_m / near_m), 1e-6)
    share = np.clip((np.log(far_m) - log_depth) / span, 0, 1)
    index = (_FARTHEST_INDEX + (255 - _FARTHEST_INDEX) * share).astype(np.uint8)
    bgr = cv2.applyColorMap(index, cv2.COLORMAP_TURBO)
    bgr[~valid] = 0
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)


def depth_range(depth_m: np.ndarray) -> tuple[float, float]:
    """Return the 1st and the 99th percentile of the valid depth; NaN where none is valid."""
    valid_m = depth_m[valid_depth(depth_m)]
    if not valid_m.size:
        return np.nan, np.nan
    near_m, far_m = np.percentile(valid_m, [1, 99])
    return float(near_m), float(far_m)


def figure(panels: Sequence[tuple[str, np.ndarray]], columns: int = 2) -> np.ndarray:
    """
    Return images side by side, each below its title.

    Parameters
    ----------
    panels : sequence of (title, image)
        RGB images (H, W, 3) uint8 of one size.
    columns : int
        Images per row.

    Returns
    -------
    (rows of panels) uint8
        RGB; an incomplete row is filled with white.

    Examples
    --------
    >>> black = np.zeros((40, 60, 3), np.uint8)
    >>> figure([('image', black), ('planes', black)]).shape
    (75, 136, 3)

    """
    framed = [_with_title(title, image) for title, image in panels]
    missing = -len(framed) % columns
    framed += [np.full_like(framed[0], 255)] * missing
    return np.vstack([np.hstack(framed[start:start + columns])
                      for start in range(0, len(framed), columns)])


def _draw_outlines(rgb: np.ndarray, labels: np.ndarray) -> None:
    """Make white where the right or lower neighbour has another label; wider in large images."""
    thickness_px = max(1, round(labels.shape[0] / 480))
    white = cv2.dilate(255 * label_edges(labels).view(np.uint8),
                       np.ones((thickness_px, thickness_px), np.uint8))
    cv2.bitwise_or(rgb, cv2.merge([white] * 3), dst=rgb)


def draw_numbers(rgb: np.ndarray, places: Mapping[int, LabelPlace]) -> None:
    """Write each label where its plane is widest, unless the plane is too thin for a number."""
    for label, place in places.items():
        if place.half_width_px > _TEXT_HALF_HEIGHT * rgb.shape[0]:
            _write_centred(rgb, str(label), (place.column, place.row))


def _write_centred(rgb: np.ndarray, text: str, centre_px: tuple[int, int]) -> None:
    """Write white text on a black box, which is legible on every colour."""
    scale = max(0.35, rgb.shape[0] / 480 * 0.5)
    (width, height), _ = cv2.getTextSize(text, _FONT, scale, 1)
    left = max(min(centre_px[0] - width // 2, rgb.shape[1] - width - 3), 2)
    base = max(min(centre_px[1] + height // 2, rgb.shape[0] - 4), height + 2)
    cv2.rectangle(rgb, (left - 2, base - height - 2), (left + width + 1, base + 3), _BLACK, -1)
    cv2.putText(rgb, text, (left, base), _FONT, scale, _WHITE, 1, cv2.LINE_AA)


def _with_title(title: str, image: np.ndarray) -> np.ndarray:
    """Return the image with a white margin and its title above, cut to the width of the image."""
    height, width = image.shape[:2]
    enlarged = max(0.75, height / 480)
    bar = np.full((round(_TITLE_HEIGHT_PX * enlarged), width, 3), 255, np.uint8)
    scale = _TITLE_SCALE * enlarged
    while title and cv2.getTextSize(title, _FONT, scale, 1)[0][0] > width - 8:
        title = title[:-1]
    cv2.putText(bar, title, (4, round(bar.shape[0] * 0.7)), _FONT, scale, _BLACK,
                max(1, round(1.6 * scale)), cv2.LINE_AA)
    return cv2.copyMakeBorder(np.vstack([bar, image]), 4, 4, 4, 4, cv2.BORDER_CONSTANT,
                              value=_WHITE)
