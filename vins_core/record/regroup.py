"""Recorded packets at another frame rate: which of their images are frames decided anew (REFERENCE T2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest

import numpy as np

from ..io.anomalies import StampWatch
from ..io.messages import ImuMessage
from ..io.sync import FrequencyControl, ImuQueue
from ..params import Frontend
from ..sensors import Anomaly, DepthRef, GpsFix, ImageRef, Packet


def regroup(packets: Iterable[Packet], params: Frontend, number: int, last_frame_ns: int | None) -> Iterator[Packet]:
    """The images and IMU samples of consecutive `packets` as packets at `params.freq`, numbered from `number` on.

    The clock of the frequency control starts at the frame before, `last_frame_ns`, or else at the first image.
    An image in a gap of the IMU is only tracked.  Where a frame falls between two samples, the recorded one that was
    interpolated there stays in, which changes an integral by less than interpolation does.
    """
    control, queue, watch = FrequencyControl(params.freq, params.max_gap_s), ImuQueue(), None
    if last_frame_ns is not None:
        control.is_due(last_frame_ns)
    images: list[ImageRef] = []
    depths: list[DepthRef | None] = []
    anomalies: list[Anomaly] = []
    fixes: list[GpsFix] = []
    for packet in packets:
        if watch is None:
            period_ns = float(np.median(np.diff(packet.imu.t_ns))) if len(packet.imu) > 1 else 0.0
            watch = StampWatch("", 1e9 / period_ns if period_ns else None)
        for t_ns, gyro, accel in zip(packet.imu.t_ns.tolist(), packet.imu.gyro_rad_s, packet.imu.accel_m_s2):
            if watch.see(t_ns):  # not so the first sample, which is the last of the packet before
                queue.append(ImuMessage(t_ns, "", gyro, accel), watch.after_gap)
        anomalies += packet.anomalies
        fixes += packet.gps
        inertial = len(packet.imu) > 0
        for (image, right), depth in zip_longest(packet.pairs, packet.depths):
            images += [image] if right is None else [image, right]
            depths += [depth] if packet.depths else []
            t_imu_ns = image.t_ns + packet.late_ns
            if control.is_due(image.t_ns) and not (inertial and queue.in_gap(t_imu_ns)):
                control.publish(image.t_ns)
                imu = queue.cut(t_imu_ns) if inertial else packet.imu
                arrived = tuple(f for f in fixes if f.t_ns <= t_imu_ns)
                yield Packet(number, tuple(images), imu, tuple(anomalies), arrived, tuple(depths))
                number, images, depths, anomalies, fixes = number + 1, [], [], [], fixes[len(arrived) :]
