# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Draw the periods and the speed against the rate, where matplotlib is installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

#: Colours that differ for everyone (Okabe and Ito).
_COLOURS = {'node': '#0072B2', 'plain loop': '#E69F00'}


#: A legend right of the axes, because the lines fill them.
_BESIDE: dict[str, Any] = {'loc': 'center left', 'bbox_to_anchor': (1.0, 0.5)}


def draw(series: dict[str, Any], folder: Path) -> list[Path]:
    """
    Draw what there is data for.

    :returns: the files
    :raises ImportError: if matplotlib is not installed
    """
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib import pyplot
    drawn = []
    for name, function in (
            ('periods', _periods), ('rates', _rates), ('worlds', _worlds)):
        if name in series:
            figure, axes = pyplot.subplots(figsize=(6.4, 3.6), layout='constrained')
            function(axes, series[name])
            axes.spines[['top', 'right']].set_visible(False)
            axes.legend(frameon=False, **({} if name != 'worlds' else _BESIDE))
            drawn.append(folder / f'{name}.png')
            figure.savefig(drawn[-1], dpi=120, metadata={'Software': None})
            pyplot.close(figure)
    return drawn


def _periods(axes: Any, data: dict[str, Any]) -> None:
    for name, colour in _COLOURS.items():
        axes.stairs([100.0 * part for part in data[name]['part']], data[name]['edges_ms'],
                    label=name, color=colour)
    axes.axvline(1e3 / data['rate'], color='0.7', zorder=0)
    axes.set(xlabel='time between two states at a subscriber [ms]', ylabel='of all periods [%]',
             yscale='log', ylim=(0.003, 100.0), title=f'real time at {data["rate"]} Hz')


def _rates(axes: Any, data: dict[str, Any]) -> None:
    for name, colour in _COLOURS.items():
        axes.plot(data['steps'], data[name], 'o-', label=name, color=colour)
    axes.set(xlabel='steps of 1 ms between two states', ylabel='of bare mj_step', xscale='log',
             ylim=(0.0, 1.05), title='free, one client on joint_states and right/wrench')
    axes.set_xticks(data['steps'], [str(steps) for steps in data['steps']], minor=False)
    axes.minorticks_off()


def _worlds(axes: Any, data: dict[str, Any]) -> None:
    for (threads, speeds), colour in zip(data['worlds'].items(), _COLOURS.values()):
        named = f'{threads} thread{"s" * (threads != "1")}'
        axes.plot(data['counts'], speeds, 'o-', label=f'worlds, {named}', color=colour)
        axes.plot(data['counts'], data['mj_step'][threads], '--', color=colour,
                  label=f'limit: bare mj_step, {named}')
    axes.set(xlabel='worlds', ylabel='world-steps per second', xscale='log', ylim=(0.0, None),
             title='Panda at a table, a stream of positions')
    axes.set_xticks(data['counts'], [str(count) for count in data['counts']], minor=False)
    axes.minorticks_off()
