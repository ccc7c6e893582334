# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""
The lifecycle node: its states, parameters, services and diagnostics.

The thread of the executor receives messages and answers services; another thread processes
frames, see frame_worker.py.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from plane_detector._runtime.compilation import compile_kernels, free_intermediate_code
from plane_detector._runtime.dependencies import explanation
from plane_detector._runtime.plain_text import plain
from plane_detector._runtime.process import tidy_after_loading
from plane_detector._runtime.stopping import Background, raise_if_stopped
from plane_detector.depth.observation import ModelOrFunction
from plane_detector.pipeline import PlaneDetector
from plane_detector.ros import parameters, qos
from plane_detector.ros.diagnostics import (
    DiagnosticsPublisher,
    Health,
    Report,
    Statistics,
    introduction,
    large_image,
    slow_network,
)
from plane_detector.ros.fault_log import MOST_OF_FAILURE, FaultLog
from plane_detector.ros.frame_processor import FrameProcessor
from plane_detector.ros.frame_worker import (
    FrameFlow,
    FrameRecords,
    FrameRequests,
    FrameWorker,
    describe_frame,
)
from plane_detector.ros.inputs.subscriptions import Subscriptions, anchor_role, input_topics
from plane_detector.ros.inputs.transforms import FrameTransforms, listen_to_tf
from plane_detector.ros.live_map import LiveMap
from plane_detector.ros.live_settings import LiveSettings, load_kernels
from plane_detector.ros.outputs.frame import DetectedFrame
from plane_detector.ros.outputs.pictures import PERIOD_S
from plane_detector.ros.outputs.topics import OUTPUTS, OutputPublishers, frame_to_json
from plane_detector.ros.point_query import PointQuery
from plane_detector.ros.spinning import CannotRunError
from plane_detector.ros.transitions import Autostart, Transitions

# Time for which destroy_node waits for the work to stop.
_STOP_TIMEOUT_S = 1.0


class PlaneDetectorNode(LifecycleNode):
    """
    The node ``plane_detector``; docs/topics.md describes its interface.

    Subscribes to image or image/compressed, camera_info, depth, depth/compressedDepth or
    depth/points, imu, clicked_point, and /tf. See
    :mod:`~plane_detector.ros.inputs.subscriptions`. Publishes ~/points, ~/points_without_floor,
    ~/ground, ~/drops, ~/grid, ~/planes, ~/planes_json, ~/detections, ~/boundaries, ~/plane_poses,
    ~/markers, ~/shapes, ~/labels, ~/depth, ~/overlay, ~/overlay/compressed, ~/camera_info,
    ~/clicked_plane and /diagnostics. See :mod:`~plane_detector.ros.outputs.topics`. Services:
    ~/detect, ~/get_planes, ~/reset_tracking and those of a lifecycle node. Parameters:
    docs/parameters.md, made from :mod:`~plane_detector.config`.

    Parameters
    ----------
    depth_model : DepthModel or callable, optional
        Used instead of the network: rgb (H, W, 3) uint8 to depth (H, W) float32.
    transforms : FrameTransforms, optional
        Used instead of TF.
    **node_options
        Of rclpy.node.Node.

    Raises
    ------
    ValueError
        A parameter has an invalid value.

    """

    def __init__(self, depth_model: ModelOrFunction | None = None,
                 transforms: FrameTransforms | None = None, **node_options: Any):
        super().__init__('plane_detector', **node_options)
        self._given_transforms = transforms
        self._listening: FrameTransforms | None = None
        self._depth_model = depth_model
        self._live = LiveSettings(self, lambda: self.state != 'unconfigured', self._on_change)
        parameters.warn_of_other_sections(self, sys.argv)
        self._statistics = Statistics()
        self._processor: FrameProcessor | None = None
        self._flow: FrameFlow | None = None
        self._retired: FrameWorker | None = None
        self._inputs: Subscriptions | None = None
        self._outputs: OutputPublishers | None = None
        self._query: PointQuery | None = None
        self._map: LiveMap | None = None
        # Answers given by another thread wake the executor.
        self._requests = FrameRequests(self.create_guard_condition(lambda: None).trigger)
        self._faults = FaultLog(self.get_logger(), 'frame skipped')
        self._health = Health(self.get_logger())
        for service, describe in (('detect', describe_frame), ('get_planes', frame_to_json)):
            self.create_service(Trigger, f'~/{service}', partial(self._on_detect, describe),
                                qos_profile=qos.service_profile(),
                                callback_group=ReentrantCallbackGroup())
        self.create_service(Trigger, '~/reset_tracking', self._on_reset_tracking,
                            qos_profile=qos.service_profile())
        self.create_timer(PERIOD_S, self._on_picture_timer,
                          clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = DiagnosticsPublisher(self, self._statistics, self._describe)
        self._transitions = Transitions(self, self._load)
        if not self._live.settings.autostart:
            name = self.get_fully_qualified_name()
            self.get_logger().info(
                f'autostart is false: waiting for a lifecycle manager, or for ros2 lifecycle set '
                f'{name} configure, then activate')
        else:
            Autostart(self, self._transitions, lambda: self._health.may_pass,
                      exits=self._live.settings.exit_on_failure)

    def destroy_node(self) -> None:
        """Stop the work and destroy the node; work that does not stop is left in its thread."""
        end_s = time.monotonic() + _STOP_TIMEOUT_S
        self._transitions.stop()
        self._release()
        for work in (self._transitions, self._retired):
            if work is not None:
                work.wait(max(end_s - time.monotonic(), 0.0))
        super().destroy_node()

    @property
    def state(self) -> str:
        """Lifecycle state: unconfigured, inactive, active, ..."""
        return self._state_machine.current_state[1]

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load the network and create the outputs; report the reason if that fails."""
        try:
            detector = self._transitions.prepared()
            self._outputs = OutputPublishers(self, OUTPUTS)
            if detector.config.map.enabled:
                self._map = LiveMap(detector.config.map, self._live.settings.target_frame)
                self._map.offer(self, detector.config.map.file)
            self._query = PointQuery(self, self._map)
            self._listening = self._needed_tf()
        except ImportError as error:
            raise CannotRunError(explanation(error)) from error
        except Exception as error:  # whatever a model file causes, the node keeps running
            self._release()
            return self._fail(f'cannot be configured: {error}', isinstance(error, OSError))
        self._health.failure = ''
        depth = self._live.config.depth
        topics = input_topics(self, self._live.settings.image_transport, depth)
        topics['image'] = topics[anchor_role(depth)]
        self._processor = FrameProcessor(detector, self._live.settings, topics['image'],
                                         self._given_transforms or self._listening,
                                         self._map)
        self._flow = FrameFlow(
            self._processor, self._outputs, self._query, self._live,
            FrameRecords(self._statistics, self._requests, self._faults, self._health))
        for line in introduction(detector.source.facts, topics,
                                 self.resolve_topic_name('~/planes')):
            self.get_logger().info(line)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe."""
        try:
            self._inputs = Subscriptions(self, self._live.config, self._live.settings,
                                         self._processor.detector.source.output,
                                         self._flow.accept,
                                         self._statistics.add_unpaired,
                                         self._given_transforms or self._listening)
        except Exception as error:  # a wrong qos_overrides parameter
            return self._fail(f'cannot be activated: {error}')
        self._health.failure = ''
        self.get_logger().info('active')
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy the subscriptions and drop the frames being processed."""
        self._unsubscribe()
        self._flow.drop()
        if self._map is not None:
            self._map.publish()
        self.get_logger().info('inactive')
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free the network and the outputs."""
        self.get_logger().info('unconfigured')
        return self._release()

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and free everything."""
        return self._release()

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to a state from which the node can be configured again."""
        return self._release()

    # Parameters and services

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """
        Set parameters, all or none; read-only ones may be set to their current values.

        `ros2 param load` sets everything that `ros2 param dump` has written, including
        qos_overrides, which rclpy declares as read-only.
        """
        changed = [parameter for parameter in parameter_list if not self._has_fixed(parameter)]
        if parameter_list and not changed:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changed)

    def _has_fixed(self, parameter: Parameter) -> bool:
        return (self.has_parameter(parameter.name)
                and self.describe_parameter(parameter.name).read_only
                and self.get_parameter(parameter.name).value == parameter.value)

    def _on_change(self) -> None:
        """Apply the settings of the inputs; the others are applied before the next frame."""
        if self._inputs is not None:
            self._inputs.apply(self._live.config, self._live.settings)

    async def _on_detect(self, describe: Callable[[DetectedFrame], str],
                         _request: Trigger.Request, response: Trigger.Response):
        if self._inputs is None:
            response.success, response.message = False, 'the node is not active'
            return response
        response.success, answer = await self._requests.add()
        response.message = describe(answer) if response.success else answer
        return response

    def _on_reset_tracking(self, _request: Trigger.Request, response: Trigger.Response):
        response.success = self._processor is not None
        if response.success:
            self._processor.detector.reset()
        response.message = ('labels and scale are reset with the next frame' if response.success
                            else 'the node is not configured')
        return response

    def _on_picture_timer(self) -> None:
        if self._flow is not None and self._inputs is not None:
            self._flow.pictures.publish_late()

    # Diagnostics

    def _describe(self, report: Report) -> tuple[bytes, str, dict[str, str]]:
        """Return level, message and facts for the diagnostics."""
        facts = {'state': self.state, 'mode': self._live.settings.mode, **self._health.facts}
        self._warn_of_namesake()
        if self._live.late_kernels.is_loading:
            facts['shapes'] = 'their kernels are being compiled'
        if self._processor is not None:
            facts.update(self._processor.detector.source.facts)
            facts['advice'] = large_image(report)
            if pace := slow_network(report, facts.get('network_input', '')):
                facts['network_pace'] = pace
                self._health.warn_once('network_pace', pace)
        if self._health.failure:
            return DiagnosticStatus.ERROR, self._health.failure, facts
        if self._inputs is None:
            return DiagnosticStatus.OK, facts['state'], facts
        if self._map is not None:
            facts.update(self._map.facts())
            for event in self._map.take_events():
                self.get_logger().warning(event)
        self._inputs.follow_publishers()
        for publishers in filter(None, (self._outputs, self._map)):
            for key, misfit in publishers.misfits().items():
                self._health.warn_once(key, misfit)
        silence, obstacle = self._inputs.watch.problem(), self._inputs.watch.obstacle()
        if not silence and report.unpaired_lately and not report.stage_seconds:
            silence = self._inputs.explain_unpaired(self.get_fully_qualified_name())
            obstacle = obstacle or silence
            self._health.warn_of_changes('unpaired', silence)
        if not silence:
            silence = self._inputs.explain_loss()
            self._health.warn_of_changes('loss', silence)
        if not silence and self._map is not None:
            silence = self._map.problem()
            self._health.warn_of_changes('map', silence)
        self._requests.expire(obstacle)
        arrivals = self._inputs.count.arrivals()
        facts['images_received'] = (
            f'{arrivals.images}, with {arrivals.camera_infos} CameraInfo, in 5 s')
        is_idle = (self._live.settings.mode == 'continuous' and self._map is None
                   and not self._outputs.wanted())
        return *self._health.status(report, silence, is_idle), facts

    def _warn_of_namesake(self) -> None:
        own = self.get_name(), self.get_namespace()
        if self.get_node_names_and_namespaces().count(own) > 1:
            name = self.get_fully_qualified_name()
            self._health.warn_once('namesake', (
                f'another node is called {name} too, and both publish on the same topics: start '
                'one of them with -r __node:=NAME (unless a node of this name has just died)'))

    def _needed_tf(self) -> FrameTransforms | None:
        """Listen to TF if the settings need it; the mounting of an IMU works without it."""
        settings = self._live.settings
        is_required = settings.base_frame or settings.target_frame
        if self._given_transforms is not None or not (is_required or settings.use_imu):
            return None
        try:
            return listen_to_tf(self)
        except ValueError:
            if is_required:
                raise
            return None

    def _load(self) -> PlaneDetector:
        """Create the pipeline, which may download the network; called in a thread."""
        while self._retired is not None and not self._retired.wait(0.1):
            raise_if_stopped()  # two networks at once could exceed the memory
        # The network first: if it is missing, that is reported before kernels are compiled.
        detector = PlaneDetector(self._live.config, self._depth_model)
        load_kernels(self._live.config, self.get_logger().info)
        free_intermediate_code()
        tidy_after_loading()
        # Planes are published meanwhile; a frame whose obstacles are subscribed to waits for it.
        Background(self._load_late_kernels, 'load_kernels')
        return detector

    def _load_late_kernels(self) -> None:
        self._health.late_failure = ''
        try:
            compile_kernels(['ground_pixels'], self.get_logger().info,
                            'the kernels of ground, obstacles and drops')
            free_intermediate_code()
        except Exception as error:
            reason = plain(f'{type(error).__name__}: {error}')
            self._health.late_failure = reason
            self.get_logger().error('no ground, obstacles and drops, because their kernels '
                                    f'cannot be compiled: {reason}')

    def _fail(self, reason: str, may_pass: bool = False) -> TransitionCallbackReturn:
        reason = plain(reason, MOST_OF_FAILURE)
        self._health.failure, self._health.may_pass = reason, may_pass
        self._statistics.set_error(reason)
        self.get_logger().error(reason)
        return TransitionCallbackReturn.FAILURE

    def _unsubscribe(self) -> None:
        if self._inputs is not None:
            self._inputs.destroy()
        self._inputs = None
        self._requests.refuse_all('the node is not active')

    def _release(self) -> TransitionCallbackReturn:
        self._unsubscribe()
        if self._flow is not None:
            self._flow.stop()
            self._retired, self._flow = self._flow.worker, None
        for ends in (self._outputs, self._map, self._query, self._listening):
            if ends is not None:
                ends.destroy()
        self._outputs = self._map = self._query = self._listening = None
        self._processor = None
        self._health.clear()
        return TransitionCallbackReturn.SUCCESS
