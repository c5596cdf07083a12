"""Steps of one method from state to state: forms of states, the propagator, steps to times and crossings, breaks."""
