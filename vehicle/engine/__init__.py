"""One step function, four ways to run it: CasADi's machine or compiled C, one vehicle or many at once."""
