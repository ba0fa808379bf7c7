"""Numbers of the vehicle model beside what theory, published tables and independent models say."""
