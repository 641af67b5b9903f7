"""Vectors of three as tuples: they live in registers."""

from probedesign.rod.kernels.compiled import inlined


@inlined
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):
    """a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def plus(a, b):
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def minus(a, b):
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inlined
def times(x, a):
    """x a."""
    return (x * a[0], x * a[1], x * a[2])


@inlined
def add(a, x, b):
    """a + x b."""
    return (a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2])


@inlined
def take(array, i):
    """Three numbers of an array from i on."""
    return (array[i], array[i + 1], array[i + 2])


@inlined
def put(array, i, a):
    """Three numbers into an array from i on."""
    array[i] = a[0]
    array[i + 1] = a[1]
    array[i + 2] = a[2]
