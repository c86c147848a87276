# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""An executor that does what waits and returns; the page asks for the newest, not for each."""

from __future__ import annotations

from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException


class PolledExecutor(SingleThreadedExecutor):
    """Runs callbacks when it is asked to, not when messages come."""

    def run_ready(self) -> None:
        """Run the callbacks of all that waits, once each, without waiting for more."""
        try:
            while True:
                task, _, _ = self.wait_for_ready_callbacks(timeout_sec=0.0)
                task()
                error = task.exception()
                if error is not None:
                    raise error
        except (TimeoutException, ShutdownException):
            pass
