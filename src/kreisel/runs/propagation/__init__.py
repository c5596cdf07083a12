"""Steps of one method from state to state: forms of states, the propagator, walks to times and crossings, breaks."""
