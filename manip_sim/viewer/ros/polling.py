# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An executor that is polled: the page wants the newest states, not to be woken by each."""

from __future__ import annotations

from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException


class PolledExecutor(SingleThreadedExecutor):
    """An executor that runs callbacks when it is polled, not when messages come."""

    def run_ready(self) -> None:
        """Run callbacks until none is ready, without waiting for more."""
        try:
            while True:
                task, _, _ = self.wait_for_ready_callbacks(timeout_sec=0.0)
                task()
                error = task.exception()
                if error is not None:
                    raise error
        except (TimeoutException, ShutdownException):
            pass
