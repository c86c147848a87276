# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Answers of ``simulation_interfaces`` to requests that fail, with their result codes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from manip_sim.errors import ManipSimError, UnknownNameError
from manip_sim.ros.standard_codes import ResultCode


class Rejection(ManipSimError):
    """A request cannot be served, with the result code that says why."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


@contextmanager
def result_filled(result: Any) -> Iterator[None]:
    """
    Write into a result whether the ``with`` block succeeds; a ``ManipSimError`` is suppressed.

    :param result: message ``Result``
    """
    result.result = int(ResultCode.RESULT_OK)
    try:
        yield
    except ManipSimError as error:
        code: int = ResultCode.RESULT_OPERATION_FAILED
        if isinstance(error, Rejection):
            code = error.code
        elif isinstance(error, UnknownNameError):
            code = ResultCode.RESULT_NOT_FOUND
        result.result, result.error_message = int(code), str(error)


def answering(fill: Callable[[Any, Any], None]) -> Callable[[Any, Any], Any]:
    """
    Return the callback of a service, which writes into the response whether it succeeded.

    :param fill: fills the response to a request, or raises a ``ManipSimError``
    """
    def answer(request: Any, response: Any) -> Any:
        with result_filled(response.result):
            fill(request, response)
        return response
    return answer
