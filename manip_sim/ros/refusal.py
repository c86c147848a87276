# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Result codes of ``simulation_interfaces`` for requests that cannot be met."""

from __future__ import annotations

from simulation_interfaces.msg import Result

from manip_sim.errors import ManipSimError, UnknownNameError


class Refusal(ManipSimError):
    """A request cannot be met, with the result code that says why."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def result_of(error: ManipSimError) -> Result:
    """Return the result that tells an error."""
    code = Result.RESULT_OPERATION_FAILED
    if isinstance(error, Refusal):
        code = error.code
    elif isinstance(error, UnknownNameError):
        code = Result.RESULT_NOT_FOUND
    return Result(result=code, error_message=str(error))
