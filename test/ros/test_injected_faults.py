# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Faults over ROS: planned by a parameter, injected by a service, told in its answers."""

import json

from diagnostic_msgs.srv import AddDiagnostics
import pytest
from std_srvs.srv import Trigger

from manip_sim.interface.composition import compose_world
from manip_sim.interface.parameter_spec import GivenParameters
from manip_sim.simulation import Simulation

PLAN = 'faults:\n- {what: offset_state, part: arm, from: 0.05, until: [0.1, 0.2], value: 0.25}\n'


@pytest.fixture
def plan(tmp_path):
    file = tmp_path / 'faults.yaml'
    file.write_text(PLAN)
    return str(file)


def test_faults_of_a_node_act_as_in_process_and_are_told_and_rejected(serve, client, plan):
    node = serve(faults=plan, seed=5, start_paused=True)

    def ask(text=''):
        return client.call(AddDiagnostics, '/manip_sim/inject_fault',
                           AddDiagnostics.Request(load_namespace=text))

    twin = Simulation(compose_world(GivenParameters({'faults': plan, 'seed': 5})).world)
    told = ask()
    assert told.success and json.loads(told.message) == twin.faults.summary()
    for text, match in (('{what: limb, part: arm}', "did you mean 'limp'"), ('[1', 'YAML'),
                        ('{what: limp, part: arms}', "did you mean 'arm'"),
                        ('{what: limp, part: arm, until: .nan}', "'until' must be a number")):
        answer = ask(text)
        assert not answer.success and match in answer.message, answer.message
    given = {'what': 'limp', 'part': 'arm', 'from': 0.02, 'until': 0.03}
    answer = ask(json.dumps(given))
    twin.faults.inject(given)
    assert answer.success and json.loads(answer.message) == twin.faults.summary()
    for _ in range(8):
        assert client.call(Trigger, '/manip_sim/step').success
        twin.advance(5)
    assert node.simulation.data.qpos.tobytes() == twin.data.qpos.tobytes()
    assert client.state().position[0] == pytest.approx(
        twin.data.qpos[0] + 0.25, abs=1e-12)
    assert json.loads(ask().message) == twin.faults.summary()
    assert [found['state'] for found in twin.faults.summary()] == ['acts', 'over']
