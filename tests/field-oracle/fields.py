"""Coil and pot by 2-D axisymmetric finite elements: A_phi with every skin depth resolved.

Unknown: A = A_phi, complex amplitude, P2 on quadrilaterals of a tensor grid. The weak form is

    int nu (grad(rA)/r . grad(rv)/r) r + j omega int sigma A v r = int J v r,   A = 0 on the axis and far away.

A saturating metal has the describing function of its B(H) as permeability at the local amplitude |H|, iterated.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse.linalg as spla
from skfem import Basis, BilinearForm, ElementQuad2, LinearForm, MeshQuad

MU_0 = 4e-7 * np.pi


@dataclass(frozen=True)
class Metal:
    """Metal: B = mu H, or with alpha (A/m) B = mu H / (1 + |H|/alpha)."""

    mu_r: float
    sigma: float  # S/m
    alpha: float = np.inf  # A/m

    def skin_depth(self, f_hz):
        return np.sqrt(2 / (2 * np.pi * f_hz * self.mu_r * MU_0 * self.sigma))

    def describing(self, h):
        """Fundamental of B over amplitude h of H, over mu at no field: Froehlich's law, by quadrature."""
        theta = (np.arange(200) + 0.5) * (np.pi / 2) / 200
        c = np.cos(theta)
        x = np.linspace(0, np.log1p(h.max() / self.alpha) + 1e-9, 400)
        grid = np.expm1(x)
        table = np.array([2 / np.pi * np.sum(2 * c * c / (1 + g * c)) * (np.pi / 2) / 200 for g in grid])
        return np.interp(np.log1p(h / self.alpha), x, table)


@dataclass(frozen=True)
class Case:
    """Arrangement, bottom to top, in metre: shield, gap, ferrite, gap, coil, gap, pot."""

    turns: float = 23.0
    coil_inner_m: float = 12.5e-3
    coil_outer_m: float = 105e-3
    coil_thickness_m: float = 3e-3
    load_gap_m: float = 5.5e-3
    ferrite_gap_m: float = 1e-3
    ferrite_thickness_m: float = 5e-3
    ferrite_radius_m: float = 105e-3
    ferrite_mu_r: float = 2000.0
    shield_gap_m: float = 0.5e-3
    shield_thickness_m: float = 1e-3  # 0: perfect conductor
    shield_sigma_s_per_m: float = 3.5e7
    pot: Metal | None = None
    pot_radius_m: float = 105e-3
    pot_thickness_m: float = 5e-3
    wall_height_m: float = 0.0  # above the base; 0: a disc
    wall_thickness_m: float = 2e-3
    foil: Metal | None = None  # below the base
    foil_thickness_m: float = 0.0
    f_hz: float = 45e3
    current_a: float = 0.0  # amplitude; saturation counts where it is above 0


@dataclass(frozen=True)
class Mesh:
    """Settings of the grid; `fine` 2 halves every cell and every growth."""

    fine: float = 1.0
    far_m: float = 0.8
    cell_m: float = 3e-3
    first_per_skin: float = 0.6  # first cell at a conductor's face, in skin depths
    growth: float = 1.7


def lines(marks, layers, mesh, low, high):
    """Ascending lines from low to high: one at each mark; cells grow from each mark, the first as `layers` (place, size) says."""
    marks = sorted(set(np.round([m for m in marks if low <= m <= high] + [low, high], 9)))
    growth = mesh.growth ** (1 / mesh.fine)
    cell = mesh.cell_m / mesh.fine
    out = [marks[0]]
    size = lambda m: min((h for at, h in layers if abs(at - m) < 1e-8), default=cell) / mesh.fine
    core = (min(m for m in marks if m > low), max(m for m in marks if m < high))
    for a, b in zip(marks, marks[1:]):
        largest = cell if (a >= core[0] - 1e-9 and b <= core[1] + 1e-9) or b - a < 4 * cell else np.inf
        left, right = [], []
        hl, hr = min(size(a), cell), min(size(b), cell)
        if b == high and high > 0.3:
            hr = np.inf
        if a == low and low < -0.3:
            hl = np.inf
        x, y = a, b
        while y - x > 1.5 * min(hl, hr) + 1e-12:
            if hl <= hr:
                x += hl
                left.append(x)
                hl = min(hl * growth, largest)
            else:
                y -= hr
                right.append(y)
                hr = min(hr * growth, largest)
        between = left + right[::-1]
        out += between + [b]
    return np.array(sorted(set(out)))


class Field:
    """Finite elements of one case."""

    def __init__(self, case, mesh=Mesh()):
        self.case, self.mesh_settings = case, mesh
        c = case
        f_bottom = c.shield_gap_m
        f_top = f_bottom + c.ferrite_thickness_m
        self.coil_z = (f_top + c.ferrite_gap_m, f_top + c.ferrite_gap_m + c.coil_thickness_m)
        p_bottom = self.coil_z[1] + c.load_gap_m
        p_top = p_bottom + c.pot_thickness_m
        r_marks = [c.coil_inner_m, c.coil_outer_m, c.ferrite_radius_m]
        z_marks = [f_bottom, f_top, *self.coil_z]
        edge = 0.5e-3
        r_layers = [(c.coil_outer_m, edge), (c.ferrite_radius_m, edge)]
        z_layers = [(f_bottom, edge), (f_top, edge)] + [(z, edge) for z in self.coil_z]
        if c.pot:
            first = mesh.first_per_skin * min(
                m.skin_depth(c.f_hz) for m in (c.pot, c.foil) if m is not None)
            r_marks += [c.pot_radius_m]
            z_marks += [p_bottom, p_top]
            r_layers += [(c.pot_radius_m, first)]
            z_layers += [(p_bottom, first), (p_top, first)]
            if c.foil:
                z_marks += [p_bottom + c.foil_thickness_m]
                z_layers += [(p_bottom + c.foil_thickness_m, first)]
            if c.wall_height_m:
                r_marks += [c.pot_radius_m - c.wall_thickness_m]
                r_layers += [(c.pot_radius_m - c.wall_thickness_m, first)]
                z_marks += [p_top + c.wall_height_m]
                z_layers += [(p_top + c.wall_height_m, first)]
        low = 0.0
        if c.shield_thickness_m:
            low = -mesh.far_m
            z_marks += [0.0, -c.shield_thickness_m]
            first = mesh.first_per_skin * Metal(1.0, c.shield_sigma_s_per_m).skin_depth(c.f_hz)
            z_layers += [(0.0, first), (-c.shield_thickness_m, first)]
        r = lines(r_marks, r_layers, mesh, 0.0, mesh.far_m)
        z = lines(z_marks, z_layers, mesh, low, mesh.far_m)
        grid = MeshQuad.init_tensor(r, z)
        middle = grid.p[:, grid.t].mean(axis=1)
        mr, mz = middle
        inside = lambda a, b, x: (x > a) & (x < b)
        cells = grid.t.shape[1]
        self.mu = np.full(cells, 1.0)
        self.sigma = np.zeros(cells)
        self.mu[inside(0, c.ferrite_radius_m, mr) & inside(f_bottom, f_top, mz)] = c.ferrite_mu_r
        if c.shield_thickness_m:
            self.sigma[inside(-c.shield_thickness_m, 0, mz)] = c.shield_sigma_s_per_m
        self.metals = []
        if c.pot:
            pot = inside(0, c.pot_radius_m, mr) & inside(p_bottom, p_top, mz)
            if c.wall_height_m:
                pot |= inside(c.pot_radius_m - c.wall_thickness_m, c.pot_radius_m, mr) & inside(
                    p_top, p_top + c.wall_height_m, mz)
            foil = pot & (mz < p_bottom + c.foil_thickness_m) if c.foil else np.zeros(cells, bool)
            for metal, where in ((c.pot, pot & ~foil), (c.foil, foil)):
                if metal:
                    self.mu[where], self.sigma[where] = metal.mu_r, metal.sigma
                    self.metals.append((metal, where))
        self.coil = inside(c.coil_inner_m, c.coil_outer_m, mr) & inside(*self.coil_z, mz)
        self.density = c.turns / ((c.coil_outer_m - c.coil_inner_m) * c.coil_thickness_m)
        self.basis = Basis(grid, ElementQuad2(), intorder=4)
        self.free = self.basis.complement_dofs(
            self.basis.get_dofs(lambda x: (x[0] < 1e-12) | (x[0] > mesh.far_m - 1e-9)
                                | (x[1] < low + 1e-12) | (x[1] > mesh.far_m - 1e-9)))
        self.cells = cells

    def impedance(self, log=None):
        """R in ohm, L in henry, unknowns."""
        c, omega = self.case, 2 * np.pi * self.case.f_hz
        basis = self.basis
        points = basis.dx.shape
        nu = np.repeat((1 / (self.mu * MU_0))[:, None], points[1], 1)

        @BilinearForm
        def stiff(u, v, w):
            r = w.x[0]
            curl = lambda a: (a.grad[0] + a / r, a.grad[1])
            (a, b), (d, e) = curl(u), curl(v)
            return w.nu * (a * d + b * e) * r

        @BilinearForm
        def mass(u, v, w):
            return w.sigma * u * v * w.x[0]

        @LinearForm
        def source(v, w):
            return w.turns * v * w.x[0]

        column = lambda values: np.repeat(values[:, None], points[1], 1)
        m = mass.assemble(basis, sigma=column(self.sigma))
        b = source.assemble(basis, turns=column(self.density * self.coil))
        last = None
        for k in range(200):
            matrix = (stiff.assemble(basis, nu=nu) + 1j * omega * m)[self.free][:, self.free].tocsc()
            a = np.zeros(b.shape, complex)
            a[self.free] = spla.splu(matrix, permc_spec="MMD_AT_PLUS_A",
                                     options=dict(SymmetricMode=True), diag_pivot_thresh=0.0).solve(b[self.free].astype(complex))
            flux = 2 * np.pi * (b @ a)
            z = 1j * omega * flux
            if log:
                log(f"iteration {k}: R {z.real:.5f} L {flux.real * 1e6:.5f}")
            if c.current_a == 0 or (last is not None and abs(z / last - 1) < 2e-5):
                return z.real, flux.real, len(self.free)
            last = z
            field = lambda part: basis.interpolate(part)
            re, im = field(a.real), field(a.imag)
            r = basis.global_coordinates().value[0]
            square = sum((x.grad[0] + x.value / r) ** 2 + x.grad[1] ** 2 for x in (re, im))
            h = np.sqrt(square) * nu * c.current_a
            for metal, where in self.metals:
                if np.isfinite(metal.alpha):
                    nu[where] = 1 / (metal.mu_r * MU_0 * metal.describing(h[where]))
        raise RuntimeError(f"{c}: saturation does not settle")


PAPER = Metal(1 / (1500 * 0.5) / MU_0, 8e6)
PAPER_SATURATING = replace(PAPER, alpha=1500.0)
CAST_IRON = Metal(1.8 / 5500 / MU_0, 1.36e6)
STAINLESS = Metal(1.02, 1.39e6)
ALUMINIUM = Metal(1.0, 3.5e7)
BRASS = Metal(1.0, 1.5e7)
COPPER = Metal(1.0, 5.8e7)
