"""The design of measurements that can detect their objects: the exposure, and where objects may stand."""
