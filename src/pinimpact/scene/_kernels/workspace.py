"""The data that the kernels of a scene share: robot, contacts, active set, and the current step."""

from __future__ import annotations

from ..._compile.workspace import Workspace, count, flag, integer, integers, real, reals, size
from ...geometry._kernels.constants import CONSTANTS
from .dop853 import DENSE_STAGES

CALLS = 8
"""Number of addresses in `calls`: four functions that kernels call in Python, each with its arguments."""

DENSE_TERMS = 7
"""Number of coefficients of the dense output per unknown, see `dense_output.interpolate`."""


class SceneWorkspace(Workspace):
    """The shared data; `pinimpact._compile.workspace` says how fields are declared and read.

    Each *source* has a mode: first the contacts (modes of `contact_forces`; held contacts last), then the
    joint limits, then the velocities, each of which dry friction may hold at rest. The *active set* consists
    of the contacts and scalar rows whose mode is not zero; `active_set.close` lays it out whenever the modes
    change.
    """

    nq = size("numbers of a configuration")
    nv = size("velocities")
    bodies = size("joints of the model, with the world")
    charts = size("rows of the table of joint charts")
    rates = size("integrated quantities of a step: ξ, v and the four kinds of work, 2 nv + 4")
    contacts = size("contacts, held ones last")
    closable = size("capacity for simultaneously active contacts; it grows, see `SceneDynamics`")
    blocks = size("groups of consecutive contacts that one bounding sphere encloses, or single contacts")
    spheres = size("groups with a bounding sphere")
    limits = size("joint limits")
    sources = size("items with a mode: contacts, limits, velocities")
    scalars = size("scalar rows that can be active: limits, and joints with dry friction")
    driven = size("drives")
    rows = size("capacity for active rows: three per active contact, then the scalar rows")

    active_contacts = count("closable", "active contacts")
    active_scalars = count("scalars", "active scalar rows: limits, then joints held by dry friction")
    active_rows = count("rows", "active rows: one of a slipping contact or scalar, three of another contact")

    # the robot, where Pinocchio reads and writes it
    calls = integers(CALLS, meaning="addresses of functions and their arguments, see `dynamics`")
    q = reals("nq", given=True, meaning="configuration that is evaluated")
    v = reals("nv", given=True, meaning="velocity that is evaluated")
    tau = reals("nv", given=True, meaning="generalized forces without contact forces")
    acceleration = reals("nv", given=True, meaning="v̇ without contact forces")
    minverse = reals("nv", "nv", given=True, meaning="M⁻¹")
    placements = reals("bodies", 12, given=True, meaning="of the joints: rotation by columns, translation")
    local_velocities = reals("bodies", 6, given=True, meaning="of the joints, in joint axes")
    spatial_velocities = reals("bodies", 6, given=True, meaning="of the joints, at the world origin")
    spatial_accelerations = reals("bodies", 6, given=True, meaning="at the world origin, minus gravity")
    joint_jacobian = reals(6, "nv", order="F", given=True, meaning="joint Jacobian at the world origin")
    control_time = real("time at which the control is evaluated [s]")
    control_force = reals("nv", meaning="generalized forces that the control returned [N or N m]")
    drive_velocity = integers("driven", meaning="index in v of each drive")
    drive_coordinate = integers("nv", meaning="index in q of the coordinate of each velocity")
    drive_stiffness = reals("nv", meaning="of the drives [N/m or N m/rad]")
    drive_damping = reals("nv", meaning="of the drives [N s/m or N m s/rad]")
    drive_reference = reals("nv", meaning="reference positions of the drives [m or rad]")
    drive_limit = reals("nv", meaning="effort limits of the drives [N or N m]")
    drive_side = integers("nv", meaning="1 for drives at their upper effort limit, −1 at the lower, else 0")
    damping = reals("nv", meaning="viscous damping of the joints")
    stiff_joints = flag("whether drives or damping may require implicit steps, see `stiff_drives`")
    dry_friction = reals("nv", meaning="dry friction of the joints [N or N m]")
    sliding_friction = reals("nv", meaning="dry friction with the sign of the velocity, 0 for held joints")

    # all contacts and joint limits
    contact_constants = reals("contacts", CONSTANTS, meaning="see `robot._kernels.constants`")
    contact_joints = integers("contacts", 2, meaning="joints of the tip and of the surface")
    joint_velocity = integers("bodies", meaning="index of the last velocity that moves each joint, or −1")
    velocity_parent = integers("nv", meaning="the preceding velocity on the path to the root, or −1")
    velocity_signs = reals("nv", meaning="of a contact: 1 moves the tip only, −1 the surface only, else 0")
    velocity_joint = integers("nv", meaning="the joint that each velocity belongs to")
    joint_metres = reals("nv", meaning="κ of (10.6): m per unit of velocity, 1 for prismatic joints")
    tree_mass = reals("bodies", meaning="mass of the tree of each joint [kg]; infinite for the world")
    contact_blocks = integers("blocks", 3, meaning="first contact, the one after the last, sphere or −1")
    sphere_constants = reals("spheres", CONSTANTS, meaning="as of a contact; joints of the first contact")
    friction = reals("contacts", meaning="coefficients of friction of sustained contact")
    bilateral = integers("contacts", meaning="1 for a held contact")
    rest_gap = reals("contacts", meaning="gap of each contact while it is active [m]")
    limit_q = integers("limits", meaning="index of the coordinate in q")
    limit_v = integers("limits", meaning="index of the velocity in v")
    limit_sign = reals("limits", meaning="1 for a lower limit, −1 for an upper one")
    limit_bound = reals("limits", meaning="value of the limit [rad or m]")

    # modes and active set
    modes = integers(
        "sources", meaning="of contacts; 1 for an active limit; 1 for a joint held by dry friction"
    )
    active_index = integers("active_contacts", meaning="number of the contact")
    active_mode = integers("active_contacts", meaning="its mode")
    active_friction = reals("active_contacts", meaning="its coefficient of friction")
    active_rest_gap = reals("active_contacts", meaning="its `rest_gap` [m]")
    slip_reference = reals("active_contacts", 2, meaning="reference (last known) direction of slip")
    start_directions = reals("active_contacts", 2, meaning="`slip_reference` at the start of the step")
    end_directions = reals("active_contacts", 2, meaning="`slip_reference` at the end of the step")
    scalar_velocity = integers("active_scalars", meaning="index in v of each scalar row")
    scalar_lower = reals("active_scalars", meaning="lower bound of the force of each scalar row [N]")
    scalar_upper = reals("active_scalars", meaning="upper bound of the force of each scalar row [N]")

    # results of an evaluation for the active set
    contact_jacobian = reals("active_contacts", 3, "nv", meaning="in contact axes t₁, t₂, n")
    contact_velocity = reals("active_contacts", 3, meaning="of the contact points [m/s]")
    contact_acceleration = reals("active_contacts", 3, meaning="without contact forces [m/s²]")
    surface_velocity = reals("active_contacts", 3, meaning="of the surfaces relative to their carriers [m/s]")
    contact_gap = reals("active_contacts", meaning="gaps [m]")
    slip_direction = reals("active_contacts", 2, meaning="directions opposite to friction")
    equation_rows = reals("active_rows", "nv", meaning="G of (9.3): rows with zero acceleration [m/s²]")
    force_response = reals("active_rows", "nv", meaning="(M⁻¹H)ᵀ: v̇ per unit of each force")
    inverse_inertia = reals("active_rows", meaning="of each row of G, without friction [1/kg]")
    system = reals("active_rows", "active_rows", meaning="matrix G M⁻¹H of (9.3)")
    target = reals("active_rows", meaning="right-hand side −a° of (9.3)")
    solution = reals("active_rows", meaning="solution x of (9.3) [N]")
    slips = integers("contacts", meaning="1 for contacts treated as sliding in the last choice of modes")
    stage_reactions = reals(13, "nv", meaning="v̇ due to active rows, at the stages of an explicit step")
    samples = integer("number of samples of the current step, see `samples`")
    sample_times = reals(7, meaning="times of the samples as fractions of the step, from 0 to 1")
    sample_margins = reals(7, meaning="force margins of the samples [N]")
    sample_slip = reals(7, "active_contacts", meaning="speeds along the reference direction of slip [m/s]")
    contact_force = reals("active_contacts", 3, meaning="in contact axes [N]")
    scalar_force = reals("active_scalars", meaning="forces of scalar rows [N or N m]")
    row_tolerance = reals("active_rows", meaning="forces taken as zero, (11.13); of a contact that of N [N]")
    force_margin = real("margin of (11.6) with `row_tolerance`; below 0 the modes do not hold [N]")
    rank_tolerance = real("relative pivot tolerance for the rank of (9.3) where forces are not unique")
    forces_unique = flag("whether the motion determines the forces; else they are those of least norm")
    callback_failed = flag("whether a call into Python or Pinocchio raised an exception")
    evaluations = integer("number of evaluations of v̇")
    evaluated = flag("whether M⁻¹ and the motion without contact forces are those where the next step starts")

    # thresholds
    gap_floor = real("rounding error of gaps: one above its negative is not closed [m]")
    touching_gap = real("gap up to which a contact is touching [m]")
    resting_speed = real("speed of a bounce that is taken as rest [m/s]; 0 if no contact can stay closed")
    least_approach = real("approach speed of a gap just closed below which it is taken as zero [m/s]")
    stick_speed = real("speed below which a contact may stick [m/s]")
    certain_speed = real("speed above which a contact keeps sliding when modes are chosen again [m/s]")
    direction_speed = real("speed below which slip keeps its reference direction [m/s]")
    gravity = real("gravitational acceleration [m/s²]")
    drift_tolerance = real("constraint drift above which it is corrected [m or m/s]")

    # the current step
    rtol = real("relative tolerance of a step")
    atol = real("absolute tolerance of a step")
    joint_charts = integers("charts", 4, meaning="table of the configuration space, see `lie_charts`")
    q0 = reals("nq", meaning="configuration at the start")
    v0 = reals("nv", meaning="velocity at the start")
    q1 = reals("nq", meaning="configuration at the end")
    v1 = reals("nv", meaning="velocity at the end")
    stage_rates = reals(DENSE_STAGES, "rates", meaning="rates of ξ, v and work at the stages")
    xi = reals("nv", meaning="chart coordinates ξ")
    tolerance_sizes = reals("nv", meaning="magnitudes for the relative tolerance of ξ")
    rate_bounds = reals(4, "nv", meaning="see `dense_output.rate_bounds`")
    dense_coefficients = reals(DENSE_TERMS, "rates", meaning="dense output, see `dense_output.interpolate`")
    slip_stiffness = real("rate at which the direction of slip settles, at the start [1/s]; see `step_radau`")
    slip_ends = real("estimated time until the first slip ends [s]; infinite if none slows down")
    stiff_length = real("step size above which steps are implicit [s], see `step_radau` and `stiff_drives`")
    drive_rate = real("rate at which the drives settle, at the start of the motion [1/s]; see `stiff_drives`")
    previous_length = real("length of the previous step [s], 0 if there is none")
    previous_error = real("error of the previous step relative to the tolerance")
    start_gaps = reals("contacts", 2, meaning="gap and gap rate at the start; infinite if not computed")
    start_spheres = reals("spheres", 2, meaning="gap and gap rate of the bounding spheres at the start")

    # the last completed step, and the first event in it
    step_start = real("time at its start [s]")
    step_length = real("its length [s]")
    method = integer("0 to 3 for explicit steps of orders 8, 5, 3, 2; 4 for implicit ones, see `step_dop853`")
    step_turns = flag("whether the directions of slip were unknowns of the step, see `step_radau`")
    gap_bounds = reals("contacts", 4, meaning="of the motion over the step, see `gap_bounds.curvatures`")
    turning_bounds = reals("contacts", meaning="ρ C of (15.4) for rims, see `contact_motion.turning_bound`")
    sphere_bounds = reals("spheres", 4, meaning="`gap_bounds` of the bounding spheres")
    clear_blocks = integers("blocks", meaning="1 if no contact of the group can close its gap in the step")
    limit_bounds = reals("limits", 4, meaning="`gap_bounds` of the joint limits")
    end_gaps = reals("contacts", 2, meaning="gap and gap rate at the end; infinite if not computed")
    end_spheres = reals("spheres", 2, meaning="gap and gap rate of the bounding spheres at the end")
    end_velocity = reals("active_contacts", 3, meaning="contact velocities at the end [m/s]")
    end_margin = real("`force_margin` at the end [N]")
    start_gain = reals(2, meaning="work of friction, of joints and contacts, since it was least [J]")
    end_gain = reals(2, meaning="`start_gain` of the next step, if no event cuts this one [J]")
    gain_tolerance = real("work added by friction that is not checked [J]")
    drift_at_end = real("constraint drift of the active set at the end, see `constraint_drift`")
    growth = real("factor from this step size to the next one")
    regular = flag("whether the last step needs no check: no event, no energy gained, constraint drift small")
    least_margin = real("force margin at which modes change; < 0 since no others were found, −inf: never [N]")
    event_time = real("time of the event [s]; infinite if there is none, −inf to request a shorter step")
    event_kind = integer("position of the event in the registry")
    event_index = integer("number of the contact, limit or velocity")
