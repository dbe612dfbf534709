"""Indices of the quantities in the flat arrays of the compiled step; imported as `at`.

The arrays are flat because a call with few array arguments is cheap, and because many vehicles are then contiguous in
memory (batch.py). A three-vector occupies its index and the two after it.
"""

from typing import Final

# --- state of one vehicle ---------------------------------------------------------------------------------------
POSITION: Final = 0  # m, NED, of the reference point (centre of mass of the bare vehicle)
VELOCITY: Final = 3  # m/s, NED
QUATERNION: Final = 6  # wxyz, body FRD to world NED
RATES: Final = 10  # rad/s, body FRD
RIGID: Final = 13  # size of the part that RK4 integrates
THRUST: Final = 13  # N, [4] of an undamaged rotor at the present speed, without ground effect
NOMINAL_THRUST: Final = 17  # N, [4] thrust of the nominal motor model under the same commands
ROTOR_PHASE: Final = 21  # rad, [4]
CHARGE_USED: Final = 25  # A s
POLARISATION: Final = 26  # V, slow part of the battery's voltage drop
VOLTAGE: Final = 27  # V, at the terminals
ACCELERATION: Final = 28  # m/s^2, NED, mean over the last sub-step
WIND: Final = 31  # m/s, NED, air velocity at the vehicle
AIRBORNE: Final = 34  # 1 when no part touches the floor
STATE_SIZE: Final = 35

# --- sums over sub-steps, zeroed by their reader ---------------------------------------------------------------
IMU_TIME: Final = 0  # s, that the next sum covers
IMU_FORCE: Final = 1  # m/s, [3] integral of the specific force, body FRD
FLOW_TIME: Final = 4  # s
FLOW_ANGLE: Final = 5  # rad, [2] integral of the optical flow
FLOW_GYRO: Final = 7  # rad, [3] integral of the rates
TRUTH_TIME: Final = 10  # s
TRUTH_FORCE: Final = 11  # N s, [3] integral of the disturbance force, NED
TRUTH_TORQUE: Final = 14  # N m s, [3] integral of the disturbance torque, body FRD
TRUTH_VELOCITY: Final = 17  # m/s, [3] velocity gained
TRUTH_RATES: Final = 20  # rad/s, [3] rates gained
IMU_TONES: Final = 23  # N, [4, 4] thrust of each rotor times cos, sin of its phase and of twice its phase
TOUCH_SPEED: Final = 39  # m/s, greatest sinking speed at a touch-down
TOUCH_TILT: Final = 40  # rad, greatest tilt at a touch-down
CURRENT: Final = 41  # A, last battery current
SUMS_SIZE: Final = 42

# --- parameters: constant until a disturbance begins or ends ----------------------------------------------------
MASS: Final = 0  # kg, with payload
CENTRE: Final = 1  # m, [3] centre of mass relative to the reference point, body
INERTIA: Final = 4  # kg m^2, [6] xx yy zz xy xz yz about the centre of mass
INVERSE: Final = 10  # 1/(kg m^2), [6] its inverse, same order
THRUST_FACTOR: Final = 16  # [4] share of the thrust left to a damaged rotor
TORQUE_FACTOR: Final = 20  # [4] share of its drag torque left
GAIN: Final = 24  # [4] motor gain
STEP: Final = 28  # s, length of a sub-step
KEEP_UP: Final = 29  # [2] share of a thrust error left after a half and a whole sub-step, rising
KEEP_DOWN: Final = 31  # [2] the same, falling
NOMINAL_KEEP: Final = 33  # [2] the same of the nominal motors after a whole sub-step: rising, falling
MAX_THRUST: Final = 35  # N per motor, at the rated voltage
TORQUE_RATIO: Final = 36  # m, drag torque per thrust
ARM_X: Final = 37  # m
ARM_Y: Final = 38  # m
ROTOR_HEIGHT: Final = 39  # m above the reference point
THRUST_SLOPE: Final = 40  # N/(rad/s)^2
ROTOR_RADIUS: Final = 41  # m
GROUND_EFFECT: Final = 42  # factor of (R/4z)^2; 0 switches it off
DRAG_LINEAR: Final = 43  # N/(m/s)
DRAG_QUADRATIC: Final = 44  # N/(m/s)^2
GRAVITY: Final = 45  # m/s^2
RATED_VOLTAGE: Final = 46  # V
FULL_VOLTAGE: Final = 47  # V
EMPTY_VOLTAGE: Final = 48  # V, open circuit
CAPACITY: Final = 49  # A s
RESISTANCE: Final = 50  # ohm
POLARISATION_RESISTANCE: Final = 51  # ohm
POLARISATION_KEEP: Final = 52  # share of the polarisation error left after a sub-step
POWER_FACTOR: Final = 53  # W/N^1.5
IDLE_CURRENT: Final = 54  # A
CONTACT_STIFFNESS: Final = 55  # N/m per point
CONTACT_DAMPING: Final = 56  # N/(m/s) per point
CONTACT_GRIP: Final = 57  # N/(m/s) per point, tangential, below sliding
FRICTION: Final = 58  # Coulomb's coefficient
FOOT_X: Final = 59  # m
FOOT_Y: Final = 60  # m
FOOT_DROP: Final = 61  # m below the reference point
NOMINAL_MASS: Final = 62  # kg
NOMINAL_INERTIA: Final = 63  # kg m^2, [3]
NOMINAL_MAX_THRUST: Final = 66  # N
NOMINAL_TORQUE_RATIO: Final = 67  # m
NOMINAL_ARM_X: Final = 68  # m
NOMINAL_ARM_Y: Final = 69  # m
SUM_TONES: Final = 70  # 1: sum IMU_TONES; 0: leave them at 0
ROTOR_SPEED: Final = 71  # [4] factor of the speed that a rotor needs for its thrust
SUM_SENSORS: Final = 75  # 1: the sums of sensors and truth; 0: none but those of the touch-downs
PARAMETERS_SIZE: Final = 76

# --- one row per disturbance that acts in every sub-step --------------------------------------------------------
ROW_NUMBER: Final = 0  # place of its class in world.catalogue.acting_classes
ROW_STAGE: Final = 1
ROW_ONSET: Final = 2  # s
ROW_END: Final = 3  # s
ROW_VALUES: Final = 4  # its settings, from here to the end of the row
NOISE_PER_ROW: Final = 3
"""Normal draws per row and sub-step, used or not, so that the kind of one row does not change the draws of another."""

# --- stages of the disturbances in a sub-step -------------------------------------------------------------------
MEAN_AIR: Final = 0
TURBULENCE: Final = 1  # effect[AIR_SPEED] is known
LOAD: Final = 2  # state[WIND] is known

# --- effect of all disturbances in a sub-step -------------------------------------------------------------------
AIR: Final = 0  # m/s, NED, [3] air velocity at the vehicle
FORCE: Final = 3  # N, NED, [3]
TORQUE: Final = 6  # N m, body FRD, [3] about the reference point
VOLTAGE_DROP: Final = 9  # V
AIR_SPEED: Final = 10  # m/s, of the vehicle through the mean air
EFFECT_SIZE: Final = 11
