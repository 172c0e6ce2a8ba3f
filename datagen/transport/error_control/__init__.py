"""Who decides how much effort each integrator gets, by pilots of error and cost; the second opinion on results."""
