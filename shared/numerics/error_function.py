"""The error function and its complement, by arithmetic and one exponential: C libraries round theirs apart.

Rational approximations of five intervals (Sun Microsystems 1993, fdlibm; errors below 1 ulp), with the coefficients and
the order of sums that glibc had up to 2.42. From 2.43 on, and on other systems, `math.erf` has other last bits.
"""

import math

from cogradar.shared.numerics.jit import kernel

# Numerators and denominators, lowest power first.
_NEAR = (
    0.128379167095512558561,
    -0.325042107247001499370,
    -2.84817495755985104766e-02,
    -5.77027029648944159157e-03,
    -2.37630166566501626084e-05,
)
_NEAR_BELOW = (
    1.0,
    0.397917223959155352819,
    6.50222499887672944485e-02,
    5.08130628187576562776e-03,
    1.32494738004321644526e-04,
    -3.96022827877536812320e-06,
)
_AT_ONE = 0.845062911510467529297
_ONE = (
    -2.36211856075265944077e-03,
    0.414856118683748331666,
    -0.372207876035701323847,
    0.318346619901161753674,
    -0.110894694282396677476,
    3.54783043256182359371e-02,
    -2.16637559486879084300e-03,
)
_ONE_BELOW = (
    1.0,
    0.106420880400844228286,
    0.540397917702171048937,
    7.18286544141962662868e-02,
    0.126171219808761642112,
    1.36370839120290507362e-02,
    1.19844998467991074170e-02,
)
_TAIL = (
    -9.86494403484714822705e-03,
    -0.693858572707181764372,
    -10.5586262253232909814,
    -62.3753324503260060396,
    -162.396669462573470355,
    -184.605092906711035994,
    -81.2874355063065934246,
    -9.81432934416914548592,
)
_TAIL_BELOW = (
    1.0,
    19.6512716674392571292,
    137.657754143519042600,
    434.565877475229228821,
    645.387271733267880336,
    429.008140027567833386,
    108.635005541779435134,
    6.57024977031928170135,
    -6.04244152148580987438e-02,
)
_FAR = (
    -9.86494292470009928597e-03,
    -0.799283237680523006574,
    -17.7579549177547519889,
    -160.636384855821916062,
    -637.566443368389627722,
    -1025.09513161107724954,
    -483.519191608651397019,
)
_FAR_BELOW = (
    1.0,
    30.3380607434824582924,
    325.792512996573918826,
    1536.72958608443695994,
    3199.85821950859553908,
    2553.05040643316442583,
    474.528541206955367215,
    -22.4409524465858183362,
)


@kernel
def erf(x: float) -> float:
    """2 / sqrt(pi) times the integral of exp(-t^2) from 0 to x."""
    size = abs(x)
    if size < 0.84375:
        return x + x * _ratio_near(x * x)
    if size < 1.25:
        return math.copysign(_AT_ONE + _ratio_at_one(size - 1.0), x)
    if size >= 6.0:
        return math.copysign(1.0, x)
    if not size < math.inf:
        return x
    return math.copysign(1.0 - _tail(size), x)


@kernel
def erfc(x: float) -> float:
    """1 - erf(x), to its last digits also where it is small."""
    size = abs(x)
    if size < 0.84375:
        y = _ratio_near(x * x)
        return 1.0 - (x + x * y) if x < 0.25 else 0.5 - (x - 0.5 + x * y)
    if size < 1.25:
        ratio = _ratio_at_one(size - 1.0)
        return 1.0 - _AT_ONE - ratio if x > 0.0 else 1.0 + (_AT_ONE + ratio)
    if size >= 28.0:
        return 0.0 if x > 0.0 else 2.0
    if not size < math.inf:
        return x
    if x < -6.0:
        return 2.0
    return _tail(size) if x > 0.0 else 2.0 - _tail(size)


@kernel
def _ratio_near(z: float) -> float:
    z2 = z * z
    z4 = z2 * z2
    p, q = _NEAR, _NEAR_BELOW
    above = (p[0] + z * p[1]) + z2 * (p[2] + z * p[3]) + z4 * p[4]
    return above / ((1.0 + z * q[1]) + z2 * (q[2] + z * q[3]) + z4 * (q[4] + z * q[5]))


@kernel
def _ratio_at_one(s: float) -> float:
    s2 = s * s
    s4 = s2 * s2
    s6 = s4 * s2
    p, q = _ONE, _ONE_BELOW
    above = (p[0] + s * p[1]) + s2 * (p[2] + s * p[3]) + s4 * (p[4] + s * p[5]) + s6 * p[6]
    return above / ((1.0 + s * q[1]) + s2 * (q[2] + s * q[3]) + s4 * (q[4] + s * q[5]) + s6 * q[6])


@kernel
def _tail(x: float) -> float:
    """erfc of 1.25 <= x < 28."""
    s = 1.0 / (x * x)
    s2 = s * s
    s4 = s2 * s2
    s6 = s4 * s2
    if x < 1.0 / 0.35:
        p, q = _TAIL, _TAIL_BELOW
        above = (p[0] + s * p[1]) + s2 * (p[2] + s * p[3]) + s4 * (p[4] + s * p[5]) + s6 * (p[6] + s * p[7])
        below = (1.0 + s * q[1]) + s2 * (q[2] + s * q[3]) + s4 * (q[4] + s * q[5]) + s6 * (q[6] + s * q[7])
        ratio = above / (below + s4 * s4 * q[8])
    else:
        a, b = _FAR, _FAR_BELOW
        above = (a[0] + s * a[1]) + s2 * (a[2] + s * a[3]) + s4 * (a[4] + s * a[5]) + s6 * a[6]
        ratio = above / ((1.0 + s * b[1]) + s2 * (b[2] + s * b[3]) + s4 * (b[4] + s * b[5]) + s6 * (b[6] + s * b[7]))
    # x in 21 bits, whose square is exact.
    unit = 2.0**-20
    while 2.0**21 * unit <= x:
        unit *= 2.0
    z = math.floor(x / unit) * unit
    return math.exp(-z * z - 0.5625) * math.exp((z - x) * (z + x) + ratio) / x
