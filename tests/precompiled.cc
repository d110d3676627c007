// A library needs a source: this one has precompiled headers for the tests.
