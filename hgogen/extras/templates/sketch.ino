/* %{name}: %{sentence}. The estimate is sent every second. */
#include <Arduino.h>

#include "%{name}.h"

%{locals}

void setup()
{
    Serial.begin(115200);
    %{init};
}

void loop()
{
    static unsigned long next = %{clock}();
    static unsigned count = 0;
    if ((long)(%{clock}() - next) < 0) {
        return;
    }
    next += %{ticks}ul; /* one call every %{pace}; a timer is more even */
%{measured}
    const %{sketched} status = %{step};
    %{estimate};
    if (++count >= %{rows}u) { /* a second */
        count = 0;
%{told}
%{printed}
        Serial.println();
    }
}
