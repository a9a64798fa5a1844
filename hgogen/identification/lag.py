"""Sensors that lag: a plant whose outputs follow by a first-order lag, y' = (h(x, u) - y)/tau.

tau is an unknown of a fit. Less than half a sample of it cannot be told from none, and of more than a quarter of a
record too little is seen.
"""

from collections.abc import Sequence

from hgogen.signal import Signal
from hgogen.system import System

LEAST, FIRST, MOST = 0.5, 2.0, 0.25  # of a sample; of a sample; of a record


def lagged(plant: System, outputs: Sequence[Signal], period: float, duration: float) -> tuple[System, list[Signal]]:
    """The plant with a state for each of these outputs, and the lags tau as parameters, in the order of the outputs.

    `period`, `duration`: of a sample and of the shortest record, in the plant's time.
    """
    low, high = LEAST * period, max(MOST * duration, 2 * FIRST * period)
    flow, output, states, lags = list(plant.flow), list(plant.output), list(plant.states), list[Signal]()
    for y in outputs:
        behind = Signal(f"{y.name}_behind", y.unit, f"{y.name} as its sensor shows it")
        tau = Signal(f"lag_of_{y.name}", plant.time, f"lag of the sensor of {y.name}", FIRST * period, low, high)
        row = plant.outputs.index(y)
        flow.append((output[row] - behind) / tau)
        output[row] = behind
        states.append(behind)
        lags.append(tau)
    slow = System(
        plant.name,
        states=states,
        inputs=plant.inputs,
        outputs=plant.outputs,
        parameters=(*plant.parameters, *lags),
        flow=flow,
        output=output,
        time=plant.time,
    )
    return slow, lags
