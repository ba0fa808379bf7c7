"""Physics: vehicles, tyres, ground and time; and the frames and the clock that all other rooms use."""
