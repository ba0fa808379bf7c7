"""The only place where the parts meet: scenarios, the loop, results, the command line."""
