# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
Segmentation of a disparity image into planes: the list of stages for each kind of depth.

All stages work on 1/z over the image. There planes are affine, the noise of stereo and of depth
networks is nearly constant, and an unknown scale and shift of a network's disparity does not
change which pixels form a plane.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plane_detector._runtime.process import retain_freed_memory
from plane_detector.config import Config
from plane_detector.geometry.disparity import disparity_range, zero_filled
from plane_detector.segmentation.cells.discarded import without_far_layer
from plane_detector.segmentation.cells.grid import TYPICAL_LENS, DisparityImage, build_cell_grid
from plane_detector.segmentation.cells.model import (
    MAX_DEVIATIONS,
    NO_FACETS,
    NO_PATCHES,
    Frame,
    PixelRegions,
    PlaneRegions,
    rename_labels,
)
from plane_detector.segmentation.cells.noise import (
    DepthKind,
    Noise,
    with_fine_depth,
    with_quantisation,
)
from plane_detector.segmentation.cells.noise_correlation import Correlation
from plane_detector.segmentation.cells.normal_slopes import NormalMap, slopes_of
from plane_detector.segmentation.fine_pass import MIN_CELL_SHARE, add_small_planes
from plane_detector.segmentation.memory import NO_MEMORY, Memory, Recall
from plane_detector.segmentation.pixels.edge_snapping import (
    GuideImage,
    blurs_steps,
    patches_of_one_colour,
    snap_to_image_edges,
)
from plane_detector.segmentation.pixels.labelling import close_gaps, find_smears, label_pixels
from plane_detector.segmentation.regions.competition import compete_for_cells, reassign_cells
from plane_detector.segmentation.regions.curved import MAX_RADIUS_M, find_curved
from plane_detector.segmentation.regions.merging import (
    MAX_NETWORK_FOLD_DEG,
    join_nearly_flat,
    merge_bowed_walls,
    merge_coplanar,
)
from plane_detector.segmentation.regions.model_selection import split_at_depth_steps
from plane_detector.segmentation.regions.region_graph import RegionGraph
from plane_detector.segmentation.search.plane_search import search_planes, sees_creases

# Lower bound of the error of depth, unless its values and its noise are finer.
# chosen: the largest rounding error of 16-bit millimetres.
DEPTH_FLOOR_M = 0.0005
# Residuals of exact planes in a disparity of unknown unit, as a share of its range.
# chosen: above the rounding of 16-bit images, 1.5e-5 of the range, by a margin.
RELATIVE_FLOOR = 1e-4
# Exact surfaces whose normals turn by less are planes: errors below the noise floor may be smooth.
# tuned: rooms at noise 0.0001 and curved scenes; 0.16 of the rooms loses its labels at 0.
MIN_TURN_DEG = 2.0
# (H, W) int32, the pieces of planes; (K,) int, the plane of each, -1 where it is curved; (K, 3)
# float64, the planes; (n,) int, the pieces that are curved.
Labelled = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def metric_noise_floor(config: Config, disparity_noise: float = 0.0, *,
                       is_measured: bool = True) -> Noise:
    """
    Return the lower bound of the noise of 1/z, in 1/m.

    Parameters
    ----------
    config : Config
        Its ``segmentation.disparity_noise``, if not 0, replaces the argument.
    disparity_noise : float
        Noise stated for a network, 1/m; 0 if none.
    is_measured : bool
        Whether the depth comes from a sensor, unless noise is stated for a network: a setting for
        the minimum noise does not turn the errors of a sensor into those of a network.

    """
    stated = config.segmentation.disparity_noise
    if is_measured and disparity_noise == 0:
        return Noise(DEPTH_FLOOR_M, least_sigma=stated)
    return Noise(DEPTH_FLOOR_M, source_sigma=stated or disparity_noise)


def unitless_noise_floor(disparity: np.ndarray, disparity_noise: float = 0.0) -> Noise:
    """
    Return the lower bound of the noise of a disparity of unknown scale and shift.

    Parameters
    ----------
    disparity : (H, W) floating
        Not finite where invalid.
    disparity_noise : float
        Noise stated for its source, in the same unit; 0 if none.

    """
    return noise_floor_of_range(disparity_range(disparity), disparity_noise)


def noise_floor_of_range(extent: float, disparity_noise: float) -> Noise:
    """Return the :func:`unitless_noise_floor` of disparities of a known range."""
    return Noise(0.0, RELATIVE_FLOOR * extent, disparity_noise, is_metric=False)


def segment(disparity: np.ndarray, noise_floor: Noise, config: Config,
            rng: np.random.Generator | None = None,
            guide: GuideImage | None = None, normals: NormalMap | None = None,
            lens: np.ndarray = TYPICAL_LENS) -> PixelRegions:
    """
    Find the regions of a disparity image that are planes.

    Parameters
    ----------
    disparity : (H, W) floating
        Affine in 1/depth, in any unit; not finite where invalid.
    noise_floor : Noise
        Lower bound of the noise; the noise itself is estimated from the disparity.
    config : Config
        Its ``segmentation``, ``ransac`` and ``dbscan`` are used.
    rng : numpy.random.Generator, optional
        Default: seeded with ``config.ransac.seed``.
    guide : GuideImage, optional
        The colour image, given if the source of the disparity blurs edges.
    normals : NormalMap, optional
        Of the same image, by a network; the disparity is 1/z then, without a shift.
    lens : (4,) float64
        See :func:`~plane_detector.segmentation.cells.grid.lens_of`; angles are approximate
        without it.

    Returns
    -------
    PixelRegions
        In the unit of the disparity. Finding no plane is not an error.

    """
    return segment_next(NO_MEMORY, disparity, noise_floor, config, rng, guide, normals, lens)[0]


def segment_next(memory: Memory, disparity: np.ndarray, noise_floor: Noise, config: Config,
                 rng: np.random.Generator | None = None,
                 guide: GuideImage | None = None, normals: NormalMap | None = None,
                 lens: np.ndarray = TYPICAL_LENS) -> tuple[PixelRegions, Memory]:
    """
    Find the regions of the next image of a stream, as :func:`segment`.

    Return them, and the memory for the image after it. :data:`NO_MEMORY` is that of the first.
    """
    retain_freed_memory()
    rng = rng or np.random.default_rng(config.ransac.seed)
    image = DisparityImage(*zero_filled(disparity))
    grid = build_cell_grid(image, lens=lens)
    noise_floor = with_fine_depth(with_quantisation(noise_floor, image), image, grid)
    if noise_floor.is_metric and noise_floor.source_sigma == 0:
        image, grid = without_far_layer(image, grid, noise_floor)
    if normals is not None:
        grid = replace(grid, normal_slope=slopes_of(grid, normals))
    memory = memory.for_grid(grid)
    min_pixels = MIN_CELL_SHARE * config.segmentation.min_plane_share * image.values.size
    frame, regions = search_planes(Frame(image, grid, noise_floor, min_pixels, config, rng,
                                         memory.hypotheses(grid)), memory)
    regions = compete_for_cells(frame, regions)
    correlation = (Correlation.of(frame.cells, regions, frame.noise)
                   if frame.kind is DepthKind.MEASURED else None)
    recall = Recall(memory, frame.cells)
    if frame.kind is DepthKind.MEASURED:
        found = _measured(frame, regions, correlation, recall)
    elif frame.kind is DepthKind.EXACT:
        found = _exact(frame, regions)
    else:
        found = _network(frame, regions)
    pieces, names, planes, curved = found
    memory, labels = recall.after(pieces, names, frame.noise), rename_labels(pieces, names)
    patches = NO_PATCHES
    if guide is not None and guide.is_usable:
        seen = guide, image.values, grid.planes_in_pixels(planes), frame.noise
        is_blurred = blurs_steps(labels, *seen)
        patches = patches_of_one_colour(guide) if is_blurred else NO_PATCHES
        labels = snap_to_image_edges(labels, *seen, is_blurred)
        labels[~image.valid] = -1
    facets = NO_FACETS
    if curved.size:
        of_curved = np.full(len(names), -1)
        of_curved[curved] = curved
        facets = rename_labels(pieces, of_curved)
    correlated_px = correlation.correlated_cells * grid.size_px**2 if correlation else 0.0
    return PixelRegions(image.values, labels, planes, grid, frame.noise, correlated_px,
                        patches=patches, facets=facets), memory


def _exact(frame: Frame, regions: PlaneRegions) -> Labelled:
    """Return the labels and planes of exact depth, for which no image before is needed."""
    graph = merge_coplanar(frame.cells, RegionGraph.of(frame.cells, regions), None)
    return _label_flat_regions(frame, graph, None, MIN_TURN_DEG, Recall(NO_MEMORY, frame.cells))


def _measured(frame: Frame, regions: PlaneRegions, correlation: Correlation | None,
              recall: Recall) -> Labelled:
    """Return the labels and planes of sensor depth, with pixel noise and smooth noise."""
    cells = frame.cells
    # Only if creases do not stand far above the noise it can hide steps.
    if not sees_creases(frame.grid, frame.noise, MAX_DEVIATIONS**2):
        regions = split_at_depth_steps(frame, regions, correlation, recall)
        regions = reassign_cells(frame, regions, correlation)
    graph = merge_coplanar(cells, RegionGraph.of(cells, regions), correlation, recall)
    return _label_flat_regions(frame, graph, correlation,
                               frame.config.segmentation.flatness_angle, recall)


def _network(frame: Frame, regions: PlaneRegions) -> Labelled:
    """Return the labels and planes of network depth, whose errors contain bends and steps."""
    graph = merge_coplanar(frame.cells, RegionGraph.of(frame.cells, regions), None,
                           max_fold_deg=MAX_NETWORK_FOLD_DEG)
    graph = merge_bowed_walls(graph)
    return (label_pixels(frame, graph), np.arange(len(graph.planes)), graph.planes,
            np.empty(0, np.int64))


def _label_flat_regions(frame: Frame, graph: RegionGraph, correlation: Correlation | None,
                        min_turn_deg: float, recall: Recall) -> Labelled:
    """Label pixels; remove curved regions last, so that no plane grows into them."""
    labels = label_pixels(frame, graph)
    if frame.kind is DepthKind.EXACT and frame.noise.is_metric:
        close_gaps(labels, graph.planes, frame.image, frame.grid,
                   frame.config.segmentation.flatness_distance)
    planes = add_small_planes(frame, labels, graph, min_turn_deg)
    max_radius_m = MAX_RADIUS_M if frame.noise.is_metric else np.inf
    curved = find_curved(graph, frame.noise.density, min_turn_deg, frame.noise.bending,
                         max_radius_m, correlation,
                         recall.bend_limits(graph.labels, len(graph.planes)))
    owner, joined = graph.owner, graph.planes
    if frame.noise.is_metric:
        owner, joined = join_nearly_flat(frame.cells, graph, curved, correlation,
                                         frame.config.segmentation, recall)
    names = np.arange(len(planes))
    names[:len(owner)] = owner
    names[curved] = -1
    if frame.noise.is_metric:
        names[find_smears(labels, planes, frame.image, frame.grid)] = -1
    return labels, names, np.concatenate([joined, planes[len(joined):]]), curved
