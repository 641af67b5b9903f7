"""ChArUco boards: their geometry, a print of exact size, and their corners in a photograph.

Axes of a board: origin at the upper left corner of the printed squares, x to the right, y downwards along the rows,
z into the board, as OpenCV has them (from version 4.6 on: the upper left square is black).
"""

import struct
import zlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from probedesign.core.errors import InputError, unknown_name
from probedesign.core.frames import Array
from probedesign.core.units import MM
from probedesign.vision import require_opencv

DICTIONARIES = {
    **{f"DICT_{n}X{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024, "DICT_APRILTAG_16h5": 30, "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320, "DICT_APRILTAG_36h11": 587,
}  # fmt: skip
"""OpenCV's dictionaries, each with its number of markers."""
MAX_SQUARES = 60
MARGIN = 10.0 * MM
"""White margin round a printed board [m]: a marker needs a white border of a module."""
PNG_DPI = 600
MIN_CORNERS = 8
"""Fewer corners of a board in a photograph are not used: six numbers of its pose leave ten equations (assumed)."""
POINT = 72.0 / 0.0254  # points of a PDF page in a metre


@dataclass(frozen=True)
class Board:
    """A chessboard with ArUco markers in its white squares.

    Raises:
        InputError: no such board exists.

    Source: S. Garrido-Jurado et al., Automatic generation and detection of highly reliable fiducial markers under
        occlusion, Pattern Recognition 47, 2014; the board is OpenCV's `aruco::CharucoBoard`.
    """

    squares: tuple[int, int]  #: number of columns and rows.
    square: float  #: side of a square [m].
    marker: float  #: side of a marker [m].
    dictionary: str  #: name of its markers' dictionary in OpenCV.

    def __post_init__(self) -> None:
        """Check the numbers against each other."""
        if self.dictionary not in DICTIONARIES:
            raise unknown_name("dictionary", self.dictionary, DICTIONARIES)
        if not all(3 <= count <= MAX_SQUARES for count in self.squares):
            raise InputError(f"squares = {list(self.squares)}: a board has 3 to {MAX_SQUARES} columns and rows")
        if not 0.3 * self.square <= self.marker <= 0.95 * self.square:
            limits = f"{0.3 * self.square / MM:g} ... {0.95 * self.square / MM:g}"
            raise InputError(f"marker_mm = {self.marker / MM:g} must lie in {limits}, 0.3 to 0.95 of square_mm")
        needed, known = self.squares[0] * self.squares[1] // 2, DICTIONARIES[self.dictionary]
        if needed > known:
            raise InputError(f"dictionary = {self.dictionary!r} has {known} markers, but the board needs {needed}; "
                             "choose a larger dictionary")  # fmt: skip

    @cached_property
    def corners(self) -> Array:
        """Inner corners of the squares in the board's axes, row by row [m], (n, 3)."""
        columns, rows = self.squares
        y, x = np.meshgrid(np.arange(1, rows), np.arange(1, columns), indexing="ij")
        return np.asarray(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square, dtype=float)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the squares together [m]."""
        return self.squares[0] * self.square, self.squares[1] * self.square

    def opencv(self) -> Any:
        """Return OpenCV's `CharucoBoard`; OpenCV must be installed."""
        require_opencv()
        import cv2

        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard(self.squares, self.square, self.marker, dictionary)

    def black_areas(self) -> Array:
        """Return the black rectangles of the print: x, y of the upper left corner, width and height [m], (n, 4)."""
        board = self.opencv()
        dictionary, columns, side = board.getDictionary(), self.squares[0], self.square
        areas = [(i * side, j * side, side, side)
                 for j in range(self.squares[1]) for i in range(columns) if (i + j) % 2 == 0]  # fmt: skip
        modules = dictionary.markerSize + 2
        module = self.marker / modules
        for number, corners in zip(board.getIds().ravel(), np.array(board.getObjPoints()), strict=True):
            # a row of black modules is one rectangle: readers of PDF draw a fine line between two
            for row, line in enumerate(dictionary.generateImageMarker(int(number), modules) == 0):
                edges = np.flatnonzero(np.diff(np.concatenate([[False], line, [False]])))
                areas += [(corners[0, 0] + a * module, corners[0, 1] + row * module, (b - a) * module, module)
                          for a, b in edges.reshape(-1, 2)]  # fmt: skip
        return np.array(areas)

    def picture(self, pixels_per_m: float) -> NDArray[np.uint8]:
        """Return the squares and markers as grey levels (height, width), without a margin; edges are whole pixels."""
        width, height = (round(length * pixels_per_m) for length in self.size)
        grey = np.full((height, width), 255, dtype=np.uint8)
        for x, y, w, h in self.black_areas() * pixels_per_m:
            grey[round(y) : round(y + h), round(x) : round(x + w)] = 0
        return grey


# the print


def board_pdf(board: Board) -> bytes:
    """Return a page of PDF with the board in its true size, its data and a line of 100 mm to check the printer."""
    width, height = board.size
    foot = 12.0 * MM
    page = [POINT * (width + 2 * MARGIN), POINT * (height + 2 * MARGIN + foot)]
    top = page[1] - POINT * MARGIN
    lines = [f"{POINT * (MARGIN + x):.4f} {top - POINT * (y + h):.4f} {POINT * w:.4f} {POINT * h:.4f} re"
             for x, y, w, h in board.black_areas()]  # fmt: skip
    lines.append("f")
    left, line = POINT * MARGIN, min(100.0 * MM, 10.0 * MM * (width // (10.0 * MM)))
    lines.append(f"0.5 w {left:.4f} 24 m {left + POINT * line:.4f} 24 l S")
    squares = f"squares {board.squares[0]} x {board.squares[1]}, square {board.square / MM:g} mm"
    text = f"{line / MM:g} mm   {squares}, marker {board.marker / MM:g} mm, {board.dictionary}"
    lines.append(f"BT /F1 7 Tf {left:.4f} 12 Td ({text}) Tj ET")
    stream = zlib.compress("\n".join(lines).encode())
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {page[0]:.4f} {page[1]:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        f"<< /Length {len(stream)} /Filter /FlateDecode >>\nstream\n".encode() + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    content, offsets = b"%PDF-1.6\n", []
    for number, body in enumerate(objects, 1):
        offsets.append(len(content))
        content += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = "".join(f"{offset:010d} 00000 n \n" for offset in offsets)
    size = len(objects) + 1
    end = f"xref\n0 {size}\n0000000000 65535 f \n{table}trailer\n<< /Size {size} /Root 1 0 R >>\n"
    return content + f"{end}startxref\n{len(content)}\n%%EOF\n".encode()


def board_png(board: Board) -> bytes:
    """Return a PNG of the board with its margin, whose resolution gives its true size (`pHYs`)."""
    import cv2

    per_m = PNG_DPI / 0.0254
    grey = np.pad(board.picture(per_m), round(MARGIN * per_m), constant_values=255)
    content = cv2.imencode(".png", grey)[1].tobytes()
    body = b"pHYs" + struct.pack(">IIB", round(per_m), round(per_m), 1)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    header = 8 + 25  # signature and IHDR, after which the chunk may be
    return content[:header] + chunk + content[header:]


# detection


def detect_board(grey: NDArray[np.uint8], board: Board) -> tuple[NDArray[np.intp], Array]:
    """Detect the corners of a board in a photograph.

    Args:
        grey: levels (height, width).
        board: which one.

    Returns:
        Numbers of the corners, rows of `Board.corners`, (n,), and their pixels (n, 2); n is 0 if no board is seen.
    """
    require_opencv()
    import cv2

    pixels, numbers, _, _ = cv2.aruco.CharucoDetector(board.opencv()).detectBoard(grey)
    if numbers is None or not len(numbers):
        return np.zeros(0, dtype=np.intp), np.zeros((0, 2))
    return np.asarray(numbers, dtype=np.intp).ravel(), np.asarray(pixels, dtype=float).reshape(-1, 2)
