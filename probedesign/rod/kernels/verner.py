"""One step of Verner's 6(5) Runge-Kutta pair on a vector of three: stages, step and error estimate.

Source: J. H. Verner, SIAM J. Numer. Anal. 15 (1978) 772-790; the pair known as DVERK. Its order conditions
are checked in tests/rod/test_order.py. Written out because many coefficients are zero and the vectors are short.
"""

import numpy as np

from probedesign.rod.kernels.compiled import inlined

STAGES = 8
C = np.array([0.0, 1 / 6, 4 / 15, 2 / 3, 5 / 6, 1.0, 1 / 15, 1.0])
"""Positions of the stages within the step."""
A = np.zeros((STAGES, STAGES))
A[1, :1] = [1 / 6]
A[2, :2] = [4 / 75, 16 / 75]
A[3, :3] = [5 / 6, -8 / 3, 5 / 2]
A[4, :4] = [-165 / 64, 55 / 6, -425 / 64, 85 / 96]
A[5, :5] = [12 / 5, -8.0, 4015 / 612, -11 / 36, 88 / 255]
A[6, :5] = [-8263 / 15000, 124 / 75, -643 / 680, -81 / 250, 2484 / 10625]
A[7, :7] = [3501 / 1720, -300 / 43, 297275 / 52632, -319 / 2322, 24068 / 84065, 0.0, 3850 / 26703]
B = np.array([3 / 40, 0.0, 875 / 2244, 23 / 72, 264 / 1955, 0.0, 125 / 11592, 43 / 616])
B_LOW = np.array([13 / 160, 0.0, 2375 / 5984, 5 / 16, 12 / 85, 3 / 44, 0.0, 0.0])
E = B - B_LOW

(A10,) = A[1, :1].tolist()
A20, A21 = A[2, :2].tolist()
A30, A31, A32 = A[3, :3].tolist()
A40, A41, A42, A43 = A[4, :4].tolist()
A50, A51, A52, A53, A54 = A[5, :5].tolist()
A60, A61, A62, A63, A64 = A[6, :5].tolist()
A70, A71, A72, A73, A74, _, A76 = A[7, :7].tolist()
B0, _, B2, B3, B4, _, B6, B7 = B.tolist()
E0, _, E2, E3, E4, E5, E6, E7 = E.tolist()

ROUNDING = 4e-15
"""Rounding error of a slope, relative; error estimates below it are meaningless."""


@inlined
def stage1(y, h, k0):
    """Return the state of stage 1."""
    a = h * A10
    return (y[0] + a * k0[0], y[1] + a * k0[1], y[2] + a * k0[2])


@inlined
def stage2(y, h, k0, k1):
    """Return the state of stage 2; likewise below."""
    return (
        y[0] + h * (A20 * k0[0] + A21 * k1[0]),
        y[1] + h * (A20 * k0[1] + A21 * k1[1]),
        y[2] + h * (A20 * k0[2] + A21 * k1[2]),
    )


@inlined
def stage3(y, h, k0, k1, k2):
    return (
        y[0] + h * (A30 * k0[0] + A31 * k1[0] + A32 * k2[0]),
        y[1] + h * (A30 * k0[1] + A31 * k1[1] + A32 * k2[1]),
        y[2] + h * (A30 * k0[2] + A31 * k1[2] + A32 * k2[2]),
    )


@inlined
def stage4(y, h, k0, k1, k2, k3):
    return (
        y[0] + h * (A40 * k0[0] + A41 * k1[0] + A42 * k2[0] + A43 * k3[0]),
        y[1] + h * (A40 * k0[1] + A41 * k1[1] + A42 * k2[1] + A43 * k3[1]),
        y[2] + h * (A40 * k0[2] + A41 * k1[2] + A42 * k2[2] + A43 * k3[2]),
    )


@inlined
def stage5(y, h, k0, k1, k2, k3, k4):
    return (
        y[0] + h * (A50 * k0[0] + A51 * k1[0] + A52 * k2[0] + A53 * k3[0] + A54 * k4[0]),
        y[1] + h * (A50 * k0[1] + A51 * k1[1] + A52 * k2[1] + A53 * k3[1] + A54 * k4[1]),
        y[2] + h * (A50 * k0[2] + A51 * k1[2] + A52 * k2[2] + A53 * k3[2] + A54 * k4[2]),
    )


@inlined
def stage6(y, h, k0, k1, k2, k3, k4):
    return (
        y[0] + h * (A60 * k0[0] + A61 * k1[0] + A62 * k2[0] + A63 * k3[0] + A64 * k4[0]),
        y[1] + h * (A60 * k0[1] + A61 * k1[1] + A62 * k2[1] + A63 * k3[1] + A64 * k4[1]),
        y[2] + h * (A60 * k0[2] + A61 * k1[2] + A62 * k2[2] + A63 * k3[2] + A64 * k4[2]),
    )


@inlined
def stage7(y, h, k0, k1, k2, k3, k4, k6):
    return (
        y[0] + h * (A70 * k0[0] + A71 * k1[0] + A72 * k2[0] + A73 * k3[0] + A74 * k4[0] + A76 * k6[0]),
        y[1] + h * (A70 * k0[1] + A71 * k1[1] + A72 * k2[1] + A73 * k3[1] + A74 * k4[1] + A76 * k6[1]),
        y[2] + h * (A70 * k0[2] + A71 * k1[2] + A72 * k2[2] + A73 * k3[2] + A74 * k4[2] + A76 * k6[2]),
    )


@inlined
def step(y, h, k0, k2, k3, k4, k6, k7):
    """Return the result of the step of order 6."""
    return (
        y[0] + h * (B0 * k0[0] + B2 * k2[0] + B3 * k3[0] + B4 * k4[0] + B6 * k6[0] + B7 * k7[0]),
        y[1] + h * (B0 * k0[1] + B2 * k2[1] + B3 * k3[1] + B4 * k4[1] + B6 * k6[1] + B7 * k7[1]),
        y[2] + h * (B0 * k0[2] + B2 * k2[2] + B3 * k3[2] + B4 * k4[2] + B6 * k6[2] + B7 * k7[2]),
    )


@inlined
def error(h, k0, k2, k3, k4, k5, k6, k7):
    """Return the 1-norm of the difference of orders 6 and 5, less the rounding error of the stages."""
    x = E0 * k0[0] + E2 * k2[0] + E3 * k3[0] + E4 * k4[0] + E5 * k5[0] + E6 * k6[0] + E7 * k7[0]
    y = E0 * k0[1] + E2 * k2[1] + E3 * k3[1] + E4 * k4[1] + E5 * k5[1] + E6 * k6[1] + E7 * k7[1]
    z = E0 * k0[2] + E2 * k2[2] + E3 * k3[2] + E4 * k4[2] + E5 * k5[2] + E6 * k6[2] + E7 * k7[2]
    size = abs(k0[0]) + abs(k0[1]) + abs(k0[2]) + abs(k7[0]) + abs(k7[1]) + abs(k7[2])
    return abs(h) * (abs(x) + abs(y) + abs(z) - ROUNDING * size)
