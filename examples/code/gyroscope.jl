# The game loop of gyroscope.c in Julia.
#
#     kreisel code free-body --name rock --language julia > rock.jl
#     julia gyroscope.jl
include("rock.jl")

const PICTURES = isempty(ARGS) ? 10_000_000 : parse(Int, ARGS[1])
const MOMENTS, DT = [5.5, 4.5, 3.0], 1 / 30

axis(q) = (2 * (q[2] * q[4] + q[1] * q[3]), 2 * (q[3] * q[4] - q[1] * q[2]), 1 - 2 * (q[2]^2 + q[3]^2))

function play(pictures)
    status = Rock.check(MOMENTS, DT)
    status == 0 || error("expected: ", Rock.message(status))
    c, s = Rock.Constants(), Rock.State()
    Rock.prepare!(c, MOMENTS, DT)
    s.M .= (0.02, 4.5, 0.01)
    s.g[1] = 1
    first = Rock.energy(c, s)
    for k in 1:5
        Rock.advance!(c, s, pictures ÷ 5) # in a game: one step a picture
        change = Rock.energy(c, s) / first - 1
        println("after $(k * (pictures ÷ 5)) steps: axis $(round.(axis(s.g); digits = 3)), energy changed by $change")
    end
    s.M[1] += 0.01 # somebody kicks it: the motion goes on from there
    Rock.advance!(c, s, 30)
    println("kicked: energy $(Rock.energy(c, s)), was $first")
end

play(PICTURES)
