# SPDX-FileCopyrightText: 2026 The plane_detector authors
# SPDX-License-Identifier: Apache-2.0
"""Images received from another process of this machine, by size, QoS and Fast DDS profile."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Sequence
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from plane_detector.evaluation.benchmark.report import emit, table
from plane_detector.ros.outputs.messages import rgb_to_msg

PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
_SHIPPED = Path(__file__).resolve().parents[3] / 'config' / 'fastdds_large_messages.xml'
# rgb8 of these sizes: 0.3, 0.9, 2.8 and 6.2 MB.
SIZES = (320, 320), (640, 480), (1280, 720), (1920, 1080)
QOS = {'reliable': ReliabilityPolicy.RELIABLE, 'best effort': ReliabilityPolicy.BEST_EFFORT}
_CONNECTED_S, _IN_FLIGHT_S = 20.0, 1.0


def use_private_domain() -> None:
    """
    Set the environment of this process and its children for large messages on this machine.

    Must be called before rclpy.init(). Other ROS nodes, on this machine or in the network, are not
    affected and do not interfere. Fast DDS settings of the user are kept.
    """
    os.environ['ROS_DOMAIN_ID'] = str(1 + os.getpid() % 100)  # above 101 ports may clash
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ.setdefault(PROFILE, str(_SHIPPED))


def report_transport(rate_hz: float, seconds: float) -> None:
    """Print the rates received without a profile and with that of this package."""
    rows = [[f'{width} x {height}', f'{3e-6 * width * height:.1f}', qos]
            for width, height in SIZES for qos in QOS]
    use_private_domain()
    shipped = os.environ.pop(PROFILE)
    for profile in (None, shipped):
        if profile is not None:
            os.environ[PROFILE] = profile
        for row, (sent, received) in zip(rows, _counts(rate_hz, seconds), strict=True):
            row.append(f'{received / seconds:.1f} of {sent / seconds:.1f}')
    emit(f'### Images received per second, of those sent, {rate_hz:g} Hz asked for',
         table(('rgb8', 'MB', 'QoS', 'no profile', 'profile of this package'), rows),
         f'One publisher and one subscriber, two processes that do nothing else, depth 2, '
         f'{seconds:g} s each, Fast DDS.')


def _counts(rate_hz: float, seconds: float) -> Sequence[tuple[int, int]]:
    """Return how many images were sent and received, of each size and QoS, in this environment."""
    context = multiprocessing.get_context('spawn')  # the environment is read when rclpy starts
    ours, theirs = context.Pipe()
    is_over = context.Event()
    receiver = context.Process(target=_receive, args=(is_over, theirs))
    sender = context.Process(target=_send, args=(rate_hz, seconds, is_over, theirs))
    receiver.start()
    sender.start()
    sent_or_received = [ours.recv(), ours.recv()]  # the sender tells first
    receiver.join()
    sender.join()
    return list(zip(*sent_or_received, strict=True))


def _topics() -> list[tuple[str, tuple[int, int], QoSProfile]]:
    return [(f'transport_{width}_{qos.replace(" ", "_")}', (width, height),
             QoSProfile(depth=2, reliability=reliability))
            for width, height in SIZES for qos, reliability in QOS.items()]


def _send(rate_hz: float, seconds: float, is_over: Event, pipe: Connection) -> None:
    """Publish images of each size and QoS in turn."""
    rclpy.init()
    node, sent = rclpy.create_node('transport_sender'), []
    for topic, (width, height), qos in _topics():
        publisher = node.create_publisher(Image, topic, qos)
        message = rgb_to_msg(Header(), np.zeros((height, width, 3), np.uint8))
        _await_subscriber(node, topic)
        end_s, next_s, count = time.monotonic() + seconds, time.monotonic(), 0
        while time.monotonic() < end_s:
            publisher.publish(message)
            count, next_s = count + 1, next_s + 1 / rate_hz
            time.sleep(max(0.0, next_s - time.monotonic()))
        time.sleep(_IN_FLIGHT_S)
        node.destroy_publisher(publisher)
        sent.append(count)
    pipe.send(sent)
    is_over.set()


def _await_subscriber(node: Node, topic: str) -> None:
    end_s = time.monotonic() + _CONNECTED_S
    while not node.count_subscribers(topic):
        if time.monotonic() > end_s:
            raise RuntimeError(f'nobody subscribed to {topic} within {_CONNECTED_S:g} s')
        time.sleep(0.05)
    time.sleep(_IN_FLIGHT_S)


def _receive(is_over: Event, pipe: Connection) -> None:
    """Count the images of each topic, as bytes, until it is over."""
    rclpy.init()
    node, received = rclpy.create_node('transport_receiver'), Counter()
    for topic, _, qos in _topics():
        node.create_subscription(Image, topic, lambda _, topic=topic: received.update([topic]),
                                 qos, raw=True)
    while not is_over.is_set():
        rclpy.spin_once(node, timeout_sec=0.05)
    pipe.send([received[topic] for topic, _, _ in _topics()])
