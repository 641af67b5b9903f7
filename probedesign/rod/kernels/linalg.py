"""Linear algebra on vectors of three and on small symmetric matrices, without allocation (compiled).

Vectors of three are tuples, so that the compiler keeps them in registers; matrices are arrays, changed in place.
"""

import math

from probedesign.rod.kernels import inlined, inner


@inlined
def dot(a, b):
    """Return a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a, b):
    """Return a × b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@inlined
def plus(a, b):
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def minus(a, b):
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inlined
def times(x, a):
    """Return x a."""
    return (x * a[0], x * a[1], x * a[2])


@inlined
def add(a, x, b):
    """Return a + x b."""
    return (a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2])


@inlined
def take(array, i):
    """Return three numbers of an array from i on."""
    return (array[i], array[i + 1], array[i + 2])


@inlined
def put(array, i, a):
    """Set three numbers of an array from i on."""
    array[i] = a[0]
    array[i + 1] = a[1]
    array[i + 2] = a[2]


#: Added to the diagonal of a scaled information matrix, so that a direction without information has a finite, huge
#: variance; it is above the rounding of the factorisation.
UNSEEN = 1e-13


@inner
def take3(A, row, j):
    """Return three rows of column j of a matrix."""
    return (A[row, j], A[row + 1, j], A[row + 2, j])


@inner
def put3(A, row, j, x):
    """Set three rows of column j of a matrix to x."""
    for q in range(3):
        A[row + q, j] = x[q]


@inner
def factor(A, n):
    """Factor A = L Lᵀ, L in the lower triangle of A, zeros above; return whether A is positive definite."""
    for j in range(n):
        total = A[j, j]
        for q in range(j):
            total -= A[j, q] * A[j, q]
        if not total > 0.0:
            return False
        pivot = math.sqrt(total)
        A[j, j] = pivot
        inverse = 1.0 / pivot
        for i in range(j + 1, n):
            total = A[i, j]
            for q in range(j):
                total -= A[i, q] * A[j, q]
            A[i, j] = total * inverse
        for i in range(j):
            A[i, j] = 0.0
    return True


@inner
def invert_lower(L, n, inverse):
    """Fill in the inverse of a lower triangle."""
    for j in range(n):
        for i in range(n):
            total = 1.0 if i == j else 0.0
            for q in range(j, i):
                total -= L[i, q] * inverse[q, j]
            inverse[i, j] = total / L[i, i] if i >= j else 0.0


@inner
def forward(L, n, b):
    """Replace b by L⁻¹ b."""
    for i in range(n):
        total = b[i]
        for q in range(i):
            total -= L[i, q] * b[q]
        b[i] = total / L[i, i]


@inner
def backward(L, n, b):
    """Replace b by L⁻ᵀ b."""
    for i in range(n - 1, -1, -1):
        total = b[i]
        for q in range(i + 1, n):
            total -= L[q, i] * b[q]
        b[i] = total / L[i, i]


@inner
def scale_and_factor(A, n, scale):
    """Factor D⁻¹ A D⁻¹ = L Lᵀ in place with D = diag(A)^½, so that metres, newtons and numbers weigh alike.

    Args:
        scale: D, filled, (n,).

    Returns:
        Whether A is positive definite; a direction without information is given UNSEEN of it.
    """
    for i in range(n):
        scale[i] = math.sqrt(A[i, i]) if A[i, i] > 0.0 else 1.0
        if not math.isfinite(scale[i]):
            return False
    for i in range(n):
        for j in range(n):
            A[i, j] /= scale[i] * scale[j]
        A[i, i] += UNSEEN
    return factor(A, n)


@inner
def solve_scaled(L, n, scale, b):
    """Replace b by A⁻¹ b after `scale_and_factor`."""
    for i in range(n):
        b[i] /= scale[i]
    forward(L, n, b)
    backward(L, n, b)
    for i in range(n):
        b[i] /= scale[i]


@inner
def covariance_of(L, n, scale, rows, m, work, cov):
    """Fill in rows A⁻¹ rowsᵀ after `scale_and_factor`, (m, m).

    Args:
        rows: (m, n); work: scratch, (m, n).
    """
    for a in range(m):
        for i in range(n):
            work[a, i] = rows[a, i] / scale[i]
        forward(L, n, work[a])
    for a in range(m):
        for b in range(a + 1):
            total = 0.0
            for i in range(n):
                total += work[a, i] * work[b, i]
            cov[a, b] = total
            cov[b, a] = total


@inner
def solve_square(A, n, B):
    """Replace B (n, m) by A⁻¹ B by elimination with pivots, overwriting A (n, n); return whether A has an inverse."""
    columns = B.shape[1]
    for j in range(n):
        at = j
        for i in range(j + 1, n):
            if abs(A[i, j]) > abs(A[at, j]):
                at = i
        if not abs(A[at, j]) > 1e-12:  # rows are of the order of one: below that the pivot is rounding
            return False
        if at != j:
            for c in range(n):
                A[j, c], A[at, c] = A[at, c], A[j, c]
            for c in range(columns):
                B[j, c], B[at, c] = B[at, c], B[j, c]
        inverse = 1.0 / A[j, j]
        for i in range(n):
            if i != j and A[i, j] != 0.0:
                share = A[i, j] * inverse
                for c in range(j, n):
                    A[i, c] -= share * A[j, c]
                for c in range(columns):
                    B[i, c] -= share * B[j, c]
        for c in range(columns):
            B[j, c] *= inverse
        for c in range(j, n):
            A[j, c] *= inverse
    return True


@inner
def principal_axis(cov, u):
    """Fill in the direction of the largest variance of a covariance (3, 3), u (3,); return that variance."""
    largest = 0
    for j in range(1, 3):
        if cov[j, j] >= cov[largest, largest]:
            largest = j
    for q in range(3):
        u[q] = cov[q, largest]
    size = 0.0
    for _ in range(12):  # power iteration; where two variances are nearly equal, any direction between them will do
        x = dot(take(cov[0], 0), take(u, 0))
        y = dot(take(cov[1], 0), take(u, 0))
        z = dot(take(cov[2], 0), take(u, 0))
        size = math.sqrt(x * x + y * y + z * z)
        if not size > 0.0:
            return 0.0
        put(u, 0, (x / size, y / size, z / size))
    return size


@inner
def smallest_variance(cov):
    """Return det over the product of the other two, from the invariants of a covariance (3, 3): a lower bound."""
    trace = cov[0, 0] + cov[1, 1] + cov[2, 2]
    a, b, c = take(cov[0], 0), take(cov[1], 0), take(cov[2], 0)
    by_a = cross(b, c)
    minors, det = by_a[0] + cross(c, a)[1] + cross(a, b)[2], dot(a, by_a)
    return max(det / max(minors, 1e-300), 0.0) if trace > 0.0 else 0.0


@inner
def eliminate(A, rows, columns, locals_):
    """Apply Householder reflections that make the first `locals_` columns of A (rows, columns) upper triangular.

    The rows below then contain all that is left for the other columns once the local unknowns are taken out.
    """
    for j in range(locals_):
        norm = 0.0
        for i in range(j, rows):
            norm += A[i, j] * A[i, j]
        norm = math.sqrt(norm)
        if norm == 0.0:
            continue
        if A[j, j] > 0.0:
            norm = -norm
        # v = column - norm e_j, kept in place; A[j, j] becomes the pivot.
        v0 = A[j, j] - norm
        half = -norm * v0  # |v|²/2
        for c in range(j + 1, columns):
            total = v0 * A[j, c]
            for i in range(j + 1, rows):
                total += A[i, j] * A[i, c]
            total /= half
            A[j, c] -= total * v0
            for i in range(j + 1, rows):
                A[i, c] -= total * A[i, j]
        A[j, j] = norm
        for i in range(j + 1, rows):
            A[i, j] = 0.0
