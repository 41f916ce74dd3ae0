"""Two pinhole cameras and an analytic texture on a plane that moves, turns and stretches: images made with the cameras' formulas and nothing of the program's."""
import numpy
from PIL import Image

generator = numpy.random.default_rng(3)
width, height, focus, distance = 200, 170, 1500.0, 100.0
waves = generator.normal(size=(300, 2)) * 9.0  # [1/mm]: some 10 px long
phases = generator.uniform(0.0, 2.0 * numpy.pi, 300)


def texture(x, y):
    total = sum(numpy.cos(k[0] * x + k[1] * y + phase) for k, phase in zip(waves, phases))
    return 128.0 + 100.0 * numpy.tanh(total / 14.0)


def camera(beta):
    """R and t of x_camera = R X + t: looks at (0, 0, -100) of the rig from `beta` degrees."""
    b = numpy.radians(beta)
    turn = numpy.array([[numpy.cos(b), 0, numpy.sin(b)], [0, 1, 0], [-numpy.sin(b), 0, numpy.cos(b)]])
    R = turn @ numpy.diag([1.0, -1.0, -1.0])
    return R, numpy.array([0, 0, distance]) - R @ numpy.array([0, 0, -distance])


def photograph(beta, A, c, push=0.0, focus=focus, half=None):
    """Of a specimen with these half sides before a dark background, or without an end. The plane's point (x, y) is at A (x, y) + c in the specimen's frame, which is the rig's, 100 mm further; the image lies `push` rows lower."""
    R, t = camera(beta)
    image = numpy.zeros((height, width))
    offsets = (-0.25, 0.25)
    for dx in offsets:
        for dy in offsets:
            column, row = numpy.meshgrid(numpy.arange(width) + dx, numpy.arange(height) + dy)
            rays = numpy.stack([(column - 100.0) / focus, (row - 85.0 - push) / focus, numpy.ones_like(column)], -1) @ R
            origin = -R.T @ t - numpy.array([0, 0, -distance]) - c
            normal = numpy.cross(A[:, 0], A[:, 1])
            hit = origin - rays * ((origin @ normal) / (rays @ normal))[..., None]
            xy = hit @ numpy.linalg.pinv(A).T
            grey = texture(xy[..., 0], xy[..., 1])
            image += 0.25 * (grey if half is None else numpy.where((numpy.abs(xy) < half).all(axis=-1), 80 + 0.6 * grey, 10.0))
    return image


def turned(degrees, axis):
    axis = numpy.asarray(axis) / numpy.linalg.norm(axis)
    K = numpy.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    a = numpy.radians(degrees)
    return numpy.eye(3) + numpy.sin(a) * K + (1 - numpy.cos(a)) * K @ K


BETAS = (-12.0, 10.0)


def save(file, image):
    """With noise of a grey level."""
    noisy = image + generator.normal(size=(height, width))
    Image.fromarray(numpy.clip(numpy.rint(noisy), 0, 255).astype(numpy.uint8)).save(file)


def write_images(folder, frames):
    """camera_0_*.png and camera_1_*.png of the frames (A, c), with noise of a grey level, and cal.xml."""
    xml = "<project><calibration>\n"
    for number, beta in enumerate(BETAS):
        for frame, (A, c) in enumerate(frames):
            save(folder / f"camera_{number}_{frame:02}.png", photograph(beta, A, c))
        t = camera(beta)[1]
        xml += f'<camera id="{number}">100 85 {focus} {focus} 0 0 0 0<orientation>180 {beta} 0 {t[0]} {t[1]} {t[2]}</orientation></camera>\n'
    (folder / "cal.xml").write_text(xml + "</calibration></project>\n")


def placement(points, digits):
    """[x, y, column, row] of points of the undeformed plane in the first camera."""
    R, t = camera(BETAS[0])
    placed = []
    for x, y in points:
        p = R @ numpy.array([x, y, -distance]) + t
        placed.append([x, y, round(100.0 + focus * p[0] / p[2], digits), round(85.0 + focus * p[1] / p[2], digits)])
    return placed
