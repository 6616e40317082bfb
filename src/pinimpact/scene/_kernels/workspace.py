"""All that the kernels of a scene share: the robot, its contacts, what is closed, and the step under way."""

from __future__ import annotations

from ..._compile.workspace import Workspace, count, flag, integer, integers, real, reals, size
from ...geometry._kernels.constants import CONSTANTS
from .dop853 import DENSE_STAGES

CALLS = 8
"""Addresses of functions and of their arguments, of what kernels call in Python."""

DENSE_TERMS = 7
"""Coefficients of the dense output of a step, see `dense_output.interpolate`."""


class SceneWorkspace(Workspace):
    """See `pinimpact._compile.workspace` for how it is declared and read.

    The modes that hold are those of `contact_forces`. Contacts stand first among the sources of modes, held
    ones last of them; then the joint limits; then each velocity, which dry friction may hold at rest. What is
    closed is rearranged whenever modes change, by `active_set.close`.
    """

    nq = size("numbers of a configuration")
    nv = size("velocities")
    bodies = size("joints of the model, with the world")
    charts = size("rows of the table of joint charts")
    rates = size("rates of a step: of ξ, v and the works, 2 nv + 4")
    contacts = size("contacts, held ones last")
    closable = size("contacts that there is room for to be closed at once; it grows, see `SceneDynamics`")
    blocks = size("runs of contacts that are looked at together: those that a sphere bounds, else one alone")
    spheres = size("runs that a sphere bounds")
    limits = size("joint limits")
    sources = size("what has a mode: contacts, limits, velocities")
    scalars = size("scalar rows that can be closed: limits, and joints with dry friction")
    driven = size("drives")
    rows = size("rows of all that there is room for: three a closable contact, then the scalar ones")

    active_contacts = count("closable", "contacts that are closed")
    active_scalars = count("scalars", "scalar rows that are closed: limits, then joints held by dry friction")
    active_rows = count("rows", "equations of what is closed: one of a slipping contact, three of another")

    # the robot, where Pinocchio reads and writes it
    calls = integers(CALLS, meaning="addresses of functions and their arguments, see `dynamics`")
    q = reals("nq", given=True, meaning="configuration that is evaluated")
    v = reals("nv", given=True, meaning="velocity that is evaluated")
    tau = reals("nv", given=True, meaning="generalized forces without those of contacts")
    acceleration = reals("nv", given=True, meaning="v̇ without contact forces")
    minverse = reals("nv", "nv", given=True, meaning="M⁻¹")
    placements = reals("bodies", 12, given=True, meaning="of the joints, rotation by columns, translation")
    local_velocities = reals("bodies", 6, given=True, meaning="of the joints, in their own axes")
    spatial_velocities = reals("bodies", 6, given=True, meaning="at the world's origin, in its axes")
    spatial_accelerations = reals("bodies", 6, given=True, meaning="at the world's origin, less gravity")
    joint_jacobian = reals(6, "nv", order="F", given=True, meaning="columns at the world's origin")
    control_time = real("when the control is asked [s]")
    control_force = reals("nv", meaning="what the control returned")
    drive_velocity = integers("driven", meaning="index in v of each drive")
    drive_coordinate = integers("nv", meaning="where the coordinate of each velocity stands in q")
    drive_stiffness = reals("nv", meaning="of the drives [N/m or N m/rad]")
    drive_damping = reals("nv", meaning="of the drives [N s/m or N m s/rad]")
    drive_reference = reals("nv", meaning="to which the drives draw [m or rad]")
    drive_limit = reals("nv", meaning="which the efforts of the drives do not exceed [N or N m]")
    drive_side = integers("nv", meaning="of each drive: 1 at its upper bound, −1 at its lower one, else 0")
    damping = reals("nv", meaning="viscous damping of the joints")
    stiff_joints = flag("whether drives or damping may ask for implicit steps, see `stiff_drives`")
    dry_friction = reals("nv", meaning="dry friction of the joints")
    sliding_friction = reals("nv", meaning="the dry friction with the sign of the velocity, 0 where held")

    # all contacts and joint limits
    contact_constants = reals("contacts", CONSTANTS, meaning="see `robot._kernels.constants`")
    contact_joints = integers("contacts", 2, meaning="joints of the tip and of the surface")
    joint_velocity = integers("bodies", meaning="the last velocity that moves each joint, or −1")
    velocity_parent = integers("nv", meaning="the velocity before each on the way to the root, or −1")
    velocity_signs = reals("nv", meaning="of a contact: 1 moves the tip only, −1 the surface only, else 0")
    velocity_joint = integers("nv", meaning="the joint that each velocity belongs to")
    joint_metres = reals("nv", meaning="per unit of each velocity: 1 of what slides, see `joint_metres`")
    contact_blocks = integers(
        "blocks", 3, meaning="first contact, the one after the last, and the sphere or −1"
    )
    sphere_constants = reals("spheres", CONSTANTS, meaning="as of a contact; its joints are its first's")
    friction = reals("contacts", meaning="coefficients of friction of sustained contact")
    bilateral = integers("contacts", meaning="1 for a held contact")
    rest_gap = reals("contacts", meaning="the gap that each keeps while closed [m]")
    limit_q = integers("limits", meaning="index of its coordinate in q")
    limit_v = integers("limits", meaning="index of its velocity in v")
    limit_sign = reals("limits", meaning="1 for a lower bound, −1 for an upper one")
    limit_bound = reals("limits", meaning="its value [rad or m]")

    # which modes hold, and what is closed in them
    modes = integers(
        "sources", meaning="of contacts; 1 for a closed limit; 1 for a joint held by dry friction"
    )
    active_index = integers("active_contacts", meaning="number of the contact")
    active_mode = integers("active_contacts", meaning="its mode")
    active_friction = reals("active_contacts", meaning="its coefficient of friction")
    active_rest_gap = reals("active_contacts", meaning="the gap that it keeps [m]")
    slip_reference = reals("active_contacts", 2, meaning="the direction of slip last known")
    start_directions = reals("active_contacts", 2, meaning="the same at the start of the step")
    end_directions = reals("active_contacts", 2, meaning="the same at its end")
    scalar_velocity = integers("active_scalars", meaning="index in v of each scalar row")
    scalar_lower = reals("active_scalars", meaning="least force of each scalar row [N]")
    scalar_upper = reals("active_scalars", meaning="largest force of each scalar row [N]")

    # what an evaluation leaves of it
    contact_jacobian = reals("active_contacts", 3, "nv", meaning="in contact axes t₁, t₂, n")
    contact_velocity = reals("active_contacts", 3, meaning="of the contact points [m/s]")
    contact_acceleration = reals("active_contacts", 3, meaning="without contact forces [m/s²]")
    surface_velocity = reals("active_contacts", 3, meaning="of the surfaces, beyond their carriers' [m/s]")
    contact_gap = reals("active_contacts", meaning="[m]")
    slip_direction = reals("active_contacts", 2, meaning="of friction")
    equation_rows = reals("active_rows", "nv", meaning="whose acceleration [m/s²] is zero")
    force_response = reals("active_rows", "nv", meaning="v̇ for a unit of each force")
    system = reals("active_rows", "active_rows", meaning="equations of the forces")
    target = reals("active_rows", meaning="their right-hand side")
    solution = reals("active_rows", meaning="their solution")
    inner_forces = reals(
        "active_rows", meaning="that are known, of which the nearest are taken where they are not unique"
    )
    found_forces = reals(
        "sources", 3, meaning="of what closed, where modes were set last; a scalar's comes first"
    )
    slips = integers("contacts", meaning="1 where modes were last looked for with its slip going on")
    stage_reactions = reals(13, "nv", meaning="v̇ due to what is closed, at the stages of an explicit step")
    samples = integer("how many samples of the step under way there are, see `samples`")
    sample_times = reals(7, meaning="where in the step, from 0 to 1")
    sample_margins = reals(7, meaning="margins of the forces there [N]")
    sample_slip = reals(7, "active_contacts", meaning="speeds of slip along the direction last known [m/s]")
    contact_force = reals("active_contacts", 3, meaning="in contact axes [N]")
    scalar_force = reals("active_scalars", meaning="[N or N m]")
    force_margin = real("by how much the forces keep to their laws; below 0 the modes do not hold [N]")
    rank_tolerance = real("part of the largest pivot that decides the rank where forces are not unique")
    forces_unique = flag("whether the motion determines the forces, else they are those of least norm")
    callback_failed = flag("whether a call into Python or Pinocchio raised")
    evaluations = integer("how often v̇ was evaluated")

    # thresholds
    gap_floor = real("gaps above its negative count as none [m]")
    touching_gap = real("at which a contact counts as touching [m]")
    resting_speed = real("of a bounce that is taken as rest [m/s]; 0 where no contact is to stay closed")
    least_approach = real("below which what has just closed its gap does not approach [m/s]")
    stick_speed = real("below which a contact may stick [m/s]")
    certain_speed = real("above which a contact keeps sliding where modes are set again [m/s]")
    direction_speed = real("below which slip has no direction but the one last known [m/s]")
    force_tolerance = real("by which Coulomb's law may seem violated through rounding [N]")

    # the step under way
    rtol = real("relative tolerance of a step")
    atol = real("absolute tolerance of a step")
    joint_charts = integers("charts", 4, meaning="table of the configuration space, see `lie_charts`")
    q0 = reals("nq", meaning="configuration at the start")
    v0 = reals("nv", meaning="velocity at the start")
    q1 = reals("nq", meaning="configuration at the end")
    v1 = reals("nv", meaning="velocity at the end")
    stage_rates = reals(DENSE_STAGES, "rates", meaning="rates of ξ, v and the works at the stages")
    xi = reals("nv", meaning="chart coordinates ξ")
    tolerance_sizes = reals("nv", meaning="what the relative tolerance of ξ refers to")
    rate_bounds = reals(4, "nv", meaning="see `dense_output.rate_bounds`")
    dense_coefficients = reals(DENSE_TERMS, "rates", meaning="dense output, see `dense_output.interpolate`")
    slip_stiffness = real("how fast the direction of slip settles at the start [1/s], see `step_radau`")
    slip_ends = real("a guess of the time until the first slip ends [s], infinite if none slows down")
    drive_rate = real("how fast the drives settled where the motion began [1/s], see `stiff_drives`")
    previous_length = real("of the step before [s], 0 where there is none")
    previous_error = real("of the step before, over the tolerance")
    start_gaps = reals("contacts", 2, meaning="gap and rate at the start; infinite where not looked at")
    start_spheres = reals("spheres", 2, meaning="the same of the spheres")

    # the end of the step last completed, and the first event in it
    step_start = real("[s]")
    step_length = real("[s]")
    method = integer("of an explicit step: 0, 1, 2 for orders 8, 5, 3, see `step_dop853`")
    step_turns = flag("whether the directions of slip were unknowns of it, see `step_radau`")
    gap_bounds = reals("contacts", 4, meaning="of the motion over the step, see `gap_bounds.curvatures`")
    turning_bounds = reals("contacts", meaning="of rims, see `contact_motion.turning_bound`")
    sphere_bounds = reals("spheres", 4, meaning="as of contacts")
    clear_blocks = integers("blocks", meaning="1 where the sphere has stayed off the surface over the step")
    limit_bounds = reals("limits", 4, meaning="likewise")
    end_gaps = reals("contacts", 2, meaning="gap and rate at the end; infinite where not looked at")
    end_spheres = reals("spheres", 2, meaning="the same of the spheres")
    end_velocity = reals("active_contacts", 3, meaning="contact velocities at the end [m/s]")
    end_margin = real("the margin of the forces at the end [N]")
    drift_at_end = real("of the active contacts, at the end; see `constraint_drift`")
    growth = real("how much longer the next step may be")
    force_bound_ignored = flag("whether forces beyond their bounds are no event: no other modes do better")
    event_time = real("[s]; infinite where there is none, minus infinity to ask for a shorter step")
    event_kind = integer("its position in the registry")
    event_index = integer("which contact, limit or velocity")
