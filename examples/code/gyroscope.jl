# The game loop of gyroscope.c in Julia.
#
#     kreisel code gyroscope.toml --method exact --name euler_top --language julia > euler_top.jl
#     julia gyroscope.jl
include("euler_top.jl")
using .EulerTop

const PICTURES = isempty(ARGS) ? 10_000_000 : parse(Int, ARGS[1])
const ENERGY, W = 9, 4 # places in the outputs: M, g, Casimir, energy

axis(q) = (2 * (q[2] * q[4] + q[1] * q[3]), 2 * (q[3] * q[4] - q[1] * q[2]), 1 - 2 * (q[2]^2 + q[3]^2))

function play(pictures)
    body = Body()
    first = observe(body)[ENERGY]
    for k in 1:5
        advance!(body, pictures ÷ 5) # in a game: one step a picture
        out = observe(body)
        change = out[ENERGY] / first - 1
        println("after $(k * (pictures ÷ 5)) steps: axis $(round.(axis(out[W:W+3]); digits = 3)), energy changed by $change")
    end
    kicked = observe(body)[1:7]
    kicked[1] += 0.01 # somebody kicks it: the motion goes on from there
    begin!(body, kicked)
    advance!(body, 30)
    println("kicked: energy $(observe(body)[ENERGY]), was $first")
end

play(PICTURES)
