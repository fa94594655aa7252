"""Flow through a hole in the floor of a hopper.

W. A. Beverloo, H. A. Leniger and J. van de Velde, Chem. Eng. Sci. 15, 260 (1961): W = C ρ √g (D - k d)^5/2, k = 1.4.
"""

import numpy as np
from validation import hopper
from validation.figures import Figure, line_through, mean_and_error

BEVERLOO_K = 1.4  # the rim of the hole is empty: so many diameters


def test_beverloo_s_law(device, publish):
    """Five holes of 5 to 9 diameters, where the law holds, in a box of 24.

    The flow is steady after 12 √(d/g); then about 800 spheres are counted, so that the level falls alike in all.
    """
    holes, durations = np.array((5.0, 6.0, 7.0, 8.0, 9.0)), (48, 26, 16, 12, 8)
    start = 12
    flows, fallen = [], []
    for hole, duration in zip(holes, durations, strict=True):
        world, first = hopper.new_hopper(hole, device)
        rows = hopper.discharge(world, first, start + duration)
        fallen.append(rows)
        flows.append(mean_and_error(np.diff(rows[start - 1 :, 1])))
    flow, error = np.transpose(flows)

    def exponent_for(k):
        return line_through(np.log(holes - k), np.log(flow), error / flow)

    (constant, _), exponent = exponent_for(BEVERLOO_K)
    # W^(2/5) is a straight line that meets zero at D = k d: the same law with the exponent given and k free.
    (at_zero, _), (slope, _) = line_through(holes, flow**0.4, 0.4 * flow**0.4 * error / flow)
    found = [Figure("exponent, with k = 1.4", *exponent, 2.5, 2.35, 2.65, "Beverloo")]
    curves = {
        "holes": holes, "flows": flows, "fallen": fallen, "logarithm_of_constant": constant, "exponent": exponent,
        "k_if_exponent_is_5/2": -at_zero / slope,
        "exponent_by_k": [(k, exponent_for(k)[1][0]) for k in (1.0, 1.2, 1.4, 1.6)],
    }  # fmt: skip
    publish("hopper", "Flow out of a hopper", found, curves)
