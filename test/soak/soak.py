# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Put the node and the viewer under load for a while and print a table of what it withstood.

``make soak`` takes about twenty minutes. Amounts are options, for instance for a night::

    make soak SOAK_ARGS='--messages 1000000 --hours 24 --stops 200'

All traffic stays on this machine, in a domain that nobody else uses.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time
import traceback

_TEST = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(_TEST), str(_TEST / 'ros'), str(_TEST / 'soak')]

from changes_load import changes  # noqa: E402
from handler_loads import actions, spawns  # noqa: E402
import loads  # noqa: E402
from request_loads import requests  # noqa: E402
from viewer_load import viewer  # noqa: E402

COLUMNS = ('load', 'amount', 'result', 'growth')


def main() -> int:
    """
    Run the loads that are asked for.

    :returns: 1 if the node did not withstand one of them
    """
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--messages', type=int, default=200_000, help='malformed messages')
    parser.add_argument('--flood', type=float, default=20.0, help='length of each flood [s]')
    parser.add_argument('--clients', type=int, default=40, help='clients that are killed')
    parser.add_argument('--stops', type=int, default=40, help='stops under traffic')
    parser.add_argument('--starts', type=int, default=200, help='stops during the start')
    parser.add_argument('--hours', type=float, default=1.0, help='simulated time [h]')
    parser.add_argument('--seed', type=int, default=1, help='of what is random')
    parser.add_argument('--requests', type=int, default=20_000,
                        help='random requests to services, and as many of parameters')
    parser.add_argument('--viewer', type=int, default=10_000,
                        help='malformed messages to the viewer')
    parser.add_argument('--spawns', type=int, default=5_000, help='random requests to spawn')
    parser.add_argument('--goals', type=int, default=20_000, help='random goals of actions')
    parser.add_argument('--changes', type=int, default=1_000,
                        help='random changes of a world whose robots come and go')
    parser.add_argument('--only', nargs='*', help='malformed, floods, clients, stops, starts, '
                        'time, requests, viewer, spawns, actions, changes')
    options = parser.parse_args()
    parts = {
        'malformed': lambda: [loads.malformed(options.messages, options.seed)],
        'floods': lambda: loads.floods(options.flood),
        'clients': lambda: [loads.vanishing_clients(options.clients)],
        'stops': lambda: [loads.stops(options.stops, options.seed)],
        'starts': lambda: [loads.starts(options.starts, options.seed)],
        'time': lambda: [loads.simulated_time(options.hours, options.seed)],
        'requests': lambda: requests(options.requests, options.seed),
        'viewer': lambda: [viewer(options.viewer, options.seed)],
        'spawns': lambda: [spawns(options.spawns, options.seed)],
        'actions': lambda: [actions(options.goals, options.seed)],
        'changes': lambda: [changes(options.changes, options.seed)]}
    lost = 0
    rows = []
    for name, part in parts.items():
        if options.only and name not in options.only:
            continue
        begin = time.monotonic()
        try:
            rows += part()
        except Exception as error:
            lost += 1
            traceback.print_exc()
            rows.append({'load': name, 'amount': '', 'growth': '',
                         'result': f'LOST: {str(error).partition(chr(10))[0]}'})
        print(f'{name}: {time.monotonic() - begin:.0f} s', file=sys.stderr, flush=True)
    print('| ' + ' | '.join(COLUMNS) + ' |')
    print('|---' * len(COLUMNS) + '|')
    for row in rows:
        print('| ' + ' | '.join(row[column] for column in COLUMNS) + ' |')
    print(f'{lost} lost')
    return 1 if lost else 0


if __name__ == '__main__':
    sys.exit(main())
