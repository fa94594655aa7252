# Test script: installs what was built, builds the project `source` against that with find_package, and runs `program`.
foreach(step IN ITEMS install configure build run)
  set(install ${CMAKE_COMMAND} --install ${built} --component cpp --prefix ${work}/installed)
  set(configure ${CMAKE_COMMAND} -S ${source} -B ${work}/build -DCMAKE_BUILD_TYPE=Release
    -DCMAKE_PREFIX_PATH=${work}/installed -DCMAKE_CXX_COMPILER=${compiler})
  set(build ${CMAKE_COMMAND} --build ${work}/build --config Release)
  set(run ${work}/build/${program})
  execute_process(COMMAND ${${step}} RESULT_VARIABLE result)
  if(NOT result EQUAL 0)
    message(FATAL_ERROR "${step}: ${result}")
  endif()
endforeach()
