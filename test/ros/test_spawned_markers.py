# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Objects that are only seen, spawned while a node runs, and moved by their topic."""

from geometry_msgs.msg import PoseStamped
import pytest
from spawning_node import ask, SpawningByParameters
from std_srvs.srv import Trigger

MARKER = '{shape: sphere, size: 0.02, visual: true}'


@pytest.mark.full
def test_a_marker_that_is_spawned_goes_where_its_topic_says_until_it_is_deleted(
        serve, client, tmp_path):
    node = serve(start_paused=True, arena='table')
    SpawningByParameters(node, tmp_path)
    counted = node.surroundings.statistics
    before = [len(list(getattr(node, kind))) for kind in ('publishers', 'subscriptions')], [
        *counted]
    for name, y in (('goal', 0.5), ('goal', -0.5)):
        answer = ask(client, 'spawn_entity', name=name, resource_string=MARKER,
                     position=[0.0, y, 1.0])
        assert answer.successful, answer.reason
        poses = client.listen(PoseStamped, 'objects/goal/pose')
        targets = client.node.create_publisher(PoseStamped, 'objects/goal/target_pose', 10)
        client.spin_until(lambda: poses and targets.get_subscription_count())  # noqa: B023
        assert poses[-1].pose.position.y == y
        target = PoseStamped()
        target.pose.position.x, target.pose.orientation.w = 0.25, 1.0
        targets.publish(target)

        def moved(poses=poses):
            client.call(Trigger, 'manip_sim/step')
            return poses[-1].pose.position.x == 0.25
        client.spin_until(moved)
        assert node.simulation.data.body('goal').xpos.tolist() == [0.25, 0.0, 0.0]
        assert counted['objects/goal'].accepted == 1
        answer = ask(client, 'delete_entity', entity='goal')
        assert answer.successful, answer.reason
        client.spin_until(lambda: not targets.get_subscription_count())  # noqa: B023
        client.spin_until(lambda: not client.node.count_publishers('objects/goal/pose'))
        client.node.destroy_publisher(targets)
        assert before == ([len(list(getattr(node, kind))) for kind in (
            'publishers', 'subscriptions')], [*counted])
