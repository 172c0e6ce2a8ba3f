"""Who decides how much effort each integrator gets, by pilots of error and cost, and the second opinion on the result."""
