# A spinning body in Godot 4: the node rotates by the file that `kreisel code` writes, everything else is Godot's.
#
#     kreisel code free-body --set I=1,2,2.5 --language gdscript --convention godot --name rock > rock.gd
#
# Put both files into the project and this one on a Node3D whose axes are the principal axes of the body.
extends Node3D

@export var moments := Vector3(1.0, 2.0, 2.5)  # kg m^2
@export var spin := Vector3(0.001, 3.0, 0.0)  # rad/s along the axes of the node
@export var torque := Vector3.ZERO  # N m along the axes of the node

var constants := Rock.Constants.new()
var state := Rock.State.new()


func _ready() -> void:
    var I := PackedFloat64Array([moments.x, moments.y, moments.z])
    var dt := 1.0 / Engine.physics_ticks_per_second
    var status := Rock.check(I, dt)
    if status != 0:
        push_error("expected a body: " + Rock.message(status))
        set_physics_process(false)
        return
    Rock.prepare(constants, I, dt)
    for k in 3:
        state.M[k] = I[k] * spin[k]
    var q := quaternion
    state.g = PackedFloat64Array([q.x, q.y, q.z, q.w])


func _physics_process(delta: float) -> void:
    impulse(0.5 * delta * torque)
    Rock.step(constants, state)
    impulse(0.5 * delta * torque)
    quaternion = Quaternion(state.g[0], state.g[1], state.g[2], state.g[3])


# A blow: torque times time, N m s, along the axes of the node.
func impulse(blow: Vector3) -> void:
    for k in 3:
        state.M[k] += blow[k]
