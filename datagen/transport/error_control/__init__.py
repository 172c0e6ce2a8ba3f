"""How much effort each integrator gets, from first runs that measure error and cost; and a check of results."""
