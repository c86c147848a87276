# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Random requests to all services and actions of the node, and random values of parameters."""

from __future__ import annotations

from collections import Counter
import random
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from random_messages import load_type, NUMBERS, random_message, TEXTS
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from std_srvs.srv import SetBool
from target import Row, SoakError, Target

#: Requests that wait for answers together; a service of ROS keeps the last ten that have come.
_BURST = 8
#: How long an answer may take [s].
_PATIENCE_S = 20.0
_FIELDS = {
    ParameterType.PARAMETER_BOOL: ('bool_value', (True, False)),
    ParameterType.PARAMETER_INTEGER: ('integer_value', (0, 1, -1, 7, 2**62, -2**63)),
    ParameterType.PARAMETER_DOUBLE: ('double_value', (*NUMBERS, 0.01, 0.5, 2.0, 250.0)),
    ParameterType.PARAMETER_STRING: ('string_value', (*TEXTS, 'velocity', 'effort')),
    ParameterType.PARAMETER_STRING_ARRAY: ('string_array_value', ([], ['arm'], list(TEXTS))),
    ParameterType.PARAMETER_DOUBLE_ARRAY: ('double_array_value', ([], [0.1] * 7, list(NUMBERS))),
    ParameterType.PARAMETER_BYTE_ARRAY: ('byte_array_value', ([b'\0'],)),
    ParameterType.PARAMETER_NOT_SET: ('bool_value', (False,))}


def random_parameter(rng: random.Random, names: list[str]) -> Parameter:
    """Return a parameter that the node has, or another, with a value of any type."""
    kind = rng.choice(tuple(_FIELDS))
    field, values = _FIELDS[kind]
    value = ParameterValue(type=kind)
    setattr(value, field, rng.choice(values))
    return Parameter(name=rng.choice(names) if rng.random() < 0.9 else rng.choice(TEXTS),
                     value=value)


class _Requests:
    """The clients of all services of a node, and what has become of requests."""

    def __init__(self, target: Target) -> None:
        self._target = target
        node = target.client.node
        target.client.spin_until(lambda: 'manip_sim' in node.get_node_names())
        self.types = {name: load_type(kinds[0]) for name, kinds in
                      node.get_service_names_and_types_by_node('manip_sim', '/')
                      if '/_action/' not in name and '/action/' not in kinds[0]}
        if not any(name.endswith('/reset') for name in self.types):
            raise SoakError(f'only the services {sorted(self.types)} were discovered')
        self.clients = {name: node.create_client(kind, name) for name, kind in self.types.items()}
        self._diagnostics = target.client.listen(DiagnosticArray, '/diagnostics', 10)
        self.sent, self.answered = Counter[str](), Counter[str]()

    def ask(self, requests: list[tuple[str, Any]]) -> None:
        """Send requests together, and wait for their answers."""
        waiting = []
        for name, request in requests:
            self._target.client.spin_until(self.clients[name].service_is_ready)
            self.sent[name] += 1
            waiting.append((name, self.clients[name].call_async(request)))
        end = time.monotonic() + _PATIENCE_S
        while any(not future.done() for _, future in waiting):
            self._target.client.executor.spin_once(timeout_sec=0.05)
            if time.monotonic() > end:
                lost = Counter(name for name, future in waiting if not future.done())
                raise SoakError(f'no answer from {dict(lost)}: {self._target.output()}')
        self.answered.update(name for name, _ in waiting)
        del self._diagnostics[:-1]

    def failures(self) -> int:
        """Return how many callbacks of the node have failed."""
        del self._diagnostics[:]
        self._target.client.spin_until(lambda: bool(self._diagnostics))
        return sum(int(pair.value) for status in self._diagnostics[-1].status
                   for pair in status.values if pair.key == 'failed_callbacks')


def requests(count: int, seed: int) -> list[Row]:
    """Ask all services for anything, and set all parameters to anything; each gets an answer."""
    rng = random.Random(seed)
    rows = []
    with Target('arena:=table') as target:
        asked = _Requests(target)
        own = 'manip_sim/'
        names = list(target.client.call(ListParameters, f'{own}list_parameters').result.names)
        before = target.client.call(GetParameters, f'{own}get_parameters',
                                    GetParameters.Request(names=names)).values

        def parameters() -> list[tuple[str, Any]]:
            return [('/manip_sim/set_parameters', SetParameters.Request(
                parameters=[random_parameter(rng, names) for _ in range(rng.randint(1, 3))]))
                for _ in range(_BURST)]

        def services() -> list[tuple[str, Any]]:
            found = [(name, random_message(rng, asked.types[name].Request))
                     for name in rng.choices(sorted(asked.types), k=_BURST)]
            for _, request in found:
                # rclpy answers no request that sets a value of an unknown type.
                for parameter in getattr(request, 'parameters', ()):
                    parameter.value.type %= 10
                # 2**64 steps are allowed, but take long.
                if hasattr(request, 'steps'):
                    request.steps %= 100
            return found
        for what, burst in (('parameters', parameters), ('services', services)):
            burst()
            asked.ask(burst())
            target.mark()
            begin, sent = time.monotonic(), asked.sent.total()
            while asked.sent.total() - sent < count:
                asked.ask(burst())
            rate = (asked.sent.total() - sent) / (time.monotonic() - begin)
            growth = target.checked_growth()
            number = len(names) if what == 'parameters' else len(asked.types)
            rows.append({
                'load': f'random {what}', 'growth': growth,
                'amount': f'{asked.sent.total() - sent} requests, {number} {what}',
                'result': f'{rate:.0f}/s, all answered'})
            target.client.call(SetBool, f'{own}pause', SetBool.Request(data=False))
            # What cannot be changed while the node runs has not changed.
            for name, value in zip(names, before):
                target.client.call(SetParameters, f'{own}set_parameters', SetParameters.Request(
                    parameters=[Parameter(name=name, value=value)]))
        failures = asked.failures()
        target.check()
        target.stop()
    rows[-1]['result'] += f', {failures} callbacks failed; obeys'
    return rows
