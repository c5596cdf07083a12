@@ head
#=
@head@

@licence@

    include("@name@.jl"); using .@module@
    body = Body()                # or of another state
    advance!(body, 1000)         # so many steps
    observe(body)                # state, Casimirs, integrals
=#
module @module@

export Body, begin!, advance!, back!, observe

@@ helpers
kreisel_where_less(x, y, yes, no) = x < y ? yes : no
kreisel_size(x) = abs(x)
kreisel_min(x, y) = x < y ? x : y
kreisel_max(x, y) = y > x ? y : x
kreisel_sign(x) = x < 0.0 ? -1.0 : 1.0

@@ projected
mutable struct Body
    z::Vector{Float64} # the method's own variables
    done::Int # steps since the last projection
    targets::Vector{Float64} # of the invariants
    worst::Vector{Float64} # the largest corrections, in units of 2^-52 |z|
    bound::Vector{Float64} # of the orientation
    spare::Vector{Float64}
    room::Vector{Float64}
end

function Body(x::AbstractVector{<:Real} = START)
    many, few = 4 * @invariants@, 4 * @bonds@ + 1
    return begin!(Body(zeros(@size@), 0, zeros(many), zeros(many), zeros(few), zeros(few), zeros(@room@)), x)
end

function begin!(body, x) # from another state: after a kick, say
    open_state!(x, body.z)
    body.done = 0
    foreach(array -> fill!(array, 0.0), (body.targets, body.worst, body.bound, body.spare))
    project!(body, 1)
    return body
end

function project!(body, begin_)
    @calls@
end

function advance!(body, steps)
    while steps > 0
        count = min(steps, @every@ - body.done)
        for _ in 1:count
            step!(body.z)
        end
        steps -= count
        body.done += count
        if body.done == @every@
            body.done = 0
            project!(body, 0)
        end
    end
    return body
end

@@ plain
struct Body
    z::Vector{Float64} # the method's own variables
end

Body() = begin!(Body(zeros(@size@)), START)

function begin!(body, x) # from another state: after a kick, say
    open_state!(x, body.z)
    return body
end

function advance!(body, steps)
    for _ in 1:steps
        step!(body.z)
    end
    return body
end

@@ back
function back!(body, steps)
    for _ in 1:steps
        step_back!(body.z)
    end
    return body
end

@@ end
function observe(body, out = zeros(@outputs@))
    outputs!(body.z, out)
    return out
end

end
@@ call
(begin_ == 1 ? begin_projection_@k@! : project_@k@!)(body.z, body.@targets@, body.@worst@, body.room)
@@ def map
function @function@!(@source@, @target@)
@@ def inplace
function @function@!(z)
@@ def stage
@table@[stage + 1, @j@]
@@ def project
function @function@!(z, targets, worst, room)
