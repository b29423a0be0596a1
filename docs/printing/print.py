"""Writes targets or a calibration board as a PDF at true size.

usage: print.py targets survey.csv targets.pdf [A4|A3|A2|A1|A0]
       print.py board board.toml board.pdf

`targets`: a page for each decal of the survey, of the given paper or of the target with a margin. `board`: one page of the
checkerboard with a margin of one square. Print at 100 % (no "fit to page") and measure the ruler: it is 100 mm long.
"""

import csv
import sys
import tomllib

PT = 72 / 25.4  # points in a millimetre
PAPERS = {"A4": (210, 297), "A3": (297, 420), "A2": (420, 594), "A1": (594, 841), "A0": (841, 1189)}
MARGIN = 20  # mm around a target: ruler and name
# Control points of a Bezier curve for an eighth of a circle, over the radius: off by 4e-6 of it.
KAPPA = 0.265216
OCTANTS = [(1, 0), (0.5**0.5, 0.5**0.5), (0, 1), (-(0.5**0.5), 0.5**0.5)]
OCTANTS += [(-x, -y) for x, y in OCTANTS]


def at(x, y):
    return f"{x * PT:.4f} {y * PT:.4f}"


def arc(x, y, radius, first, count):
    """Path of a number of octants about a centre, from the first on; all in mm."""
    corner = [(x + radius * c, y + radius * s) for c, s in OCTANTS]
    path = f"{at(*corner[first % 8])} m\n"
    for k in range(first, first + count):
        (c, s), (d, t) = OCTANTS[k % 8], OCTANTS[(k + 1) % 8]
        begin = at(x + radius * (c - KAPPA * s), y + radius * (s + KAPPA * c))
        end = at(x + radius * (d + KAPPA * t), y + radius * (t - KAPPA * d))
        path += f"{begin} {end} {at(*corner[(k + 1) % 8])} c\n"
    return path


def text(x, y, words):
    words = words.encode("latin-1", "replace").decode("latin-1").translate({92: "\\\\", 40: "\\(", 41: "\\)"})
    return f"BT /F1 9 Tf {at(x, y)} Td ({words}) Tj ET\n"


def ruler(x, y):
    return f"0.3 w {at(x, y)} m {at(x + 100, y)} l S\n" + "".join(
        f"{at(x + k, y)} m {at(x + k, y + 3)} l S\n" for k in range(0, 101, 10)
    ) + text(x, y - 5, "100 mm: if the print differs, switch scaling off")


def target(row, paper):
    """Content and size of the page of a target, mm."""
    diameter = 1e3 * float(row["diameter_m"])
    least = (max(diameter + 2 * MARGIN, 140), diameter + 4 * MARGIN)
    width, height = PAPERS[paper] if paper else least
    if width < diameter or height < diameter + 3 * MARGIN:
        sys.exit(f"{row['id']}: a target of {diameter:.0f} mm does not fit {paper}; use larger paper, or name none")
    x, y, radius = width / 2, height / 2 + MARGIN / 2, diameter / 2
    if row["shape"] == "circle":
        content = arc(x, y, radius, 0, 8) + "f\n"
    else:
        # Two opposite quadrants, edges at 45 degrees to the direction of the camera; the outline is the cutting line.
        content = "".join(arc(x, y, radius, k, 2) + f"{at(x, y)} l h f\n" for k in (7, 3))
        content += "0.1 w\n" + arc(x, y, radius, 0, 8) + "S\n"
    name = f"{row['id']}, {row['shape']}, diameter {diameter:.1f} mm: cut along the outline"
    if row["shape"] == "quadrant":
        name += ", this side to the camera"
    return content + text(MARGIN, 1.3 * MARGIN, name) + ruler(MARGIN, MARGIN / 2), (width, height)


def board(file):
    """Content and size of the page of a board, mm."""
    with open(file, "rb") as opened:
        values = tomllib.load(opened)
    if values.get("pattern") != "checkerboard":
        sys.exit(f"{file}: only a checkerboard can be printed; for an AprilGrid use kalibr_create_target_pdf")
    columns, rows, side = values["columns"] + 1, values["rows"] + 1, 1e3 * values["square_m"]
    black = [(i, j) for i in range(columns) for j in range(rows) if (i + j) % 2 == 0]
    content = "".join(f"{at((i + 1) * side, (j + 1) * side)} {at(side, side)} re f\n" for i, j in black)
    words = f"{values['columns']} x {values['rows']} inner corners, squares of {side:.2f} mm: measure them, and correct square_m"
    content += text(side, 0.55 * side, words) + ruler(side, 0.25 * side)
    return content, ((columns + 2) * side, (rows + 2) * side)


def write(file, pages):
    """A PDF of pages, each its content and its size in mm."""
    objects = ["<< /Type /Catalog /Pages 2 0 R >>", "", "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"]
    kids = []
    for content, (width, height) in pages:
        kids.append(f"{len(objects) + 1} 0 R")
        box = f"/MediaBox [0 0 {width * PT:.4f} {height * PT:.4f}]"
        font = "/Resources << /Font << /F1 3 0 R >> >>"
        objects.append(f"<< /Type /Page /Parent 2 0 R {box} {font} /Contents {len(objects) + 2} 0 R >>")
        objects.append(f"<< /Length {len(content)} >>\nstream\n{content}endstream")
    objects[1] = f"<< /Type /Pages /Kids [{' '.join(kids)}] /Count {len(kids)} >>"
    # Viewers apply no scaling by themselves.
    objects[0] = objects[0].replace(" >>", " /ViewerPreferences << /PrintScaling /None >> >>")
    data, places = b"%PDF-1.6\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n{body}\nendobj\n".encode("latin-1")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    end = f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}"
    end += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    with open(file, "wb") as opened:
        opened.write(data + end.encode("latin-1"))
    print(f"{file}: {len(pages)} pages at true size")


def main(arguments):
    match arguments:
        case ["targets", survey, output, *paper] if len(paper) < 2 and all(p in PAPERS for p in paper):
            with open(survey, newline="") as opened:
                lines = [line for line in opened if not line.startswith("# ")]
            rows = [row for row in csv.DictReader(lines) if row["shape"] in ("circle", "quadrant")]
            if not rows:
                sys.exit(f"{survey}: no row has the shape circle or quadrant")
            write(output, [target(row, *(paper or [None])) for row in rows])
        case ["board", file, output]:
            write(output, [board(file)])
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
